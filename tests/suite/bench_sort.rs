//! `bench sort` on short lists: a row per length, and what is refused.

use std::fs;

use cutwater::Error;
use cutwater::measure::bench_sort::{Options, bench_sort};

use crate::common::gpu;

#[test]
fn the_table_has_a_row_per_length() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut options = Options {
        entries: vec![0, 1, 3000],
        bits: 20,
        repeats: 2,
    };
    let mut told = 0;
    let table = bench_sort(gpu, &options, folder.path(), &mut |_| told += 1).unwrap();
    assert_eq!((told, table.rows.len()), (3, 3));
    for (row, entries) in table.rows.iter().zip(options.entries) {
        let ordered =
            row.seconds_min <= row.seconds_median && row.seconds_median <= row.seconds_max;
        assert!(ordered && row.seconds_min > 0.0, "{row:?}");
        // Three bytes of the keys: six passes of twenty bytes.
        assert_eq!((row.entries, row.bytes), (entries, 120.0 * entries as f64));
    }
    let csv = fs::read_to_string(folder.path().join("sort.csv")).unwrap();
    assert!(csv.starts_with("entries,bits,") && csv.lines().count() == 4);
    let json = fs::read_to_string(folder.path().join("sort.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["adapter"], gpu.report().name);
    assert_eq!(json["rows"][2]["entries"], 3000);

    options.entries = vec![1, usize::MAX >> 8];
    match bench_sort(gpu, &options, folder.path(), &mut |_| ()) {
        Err(Error::Limit { what, .. }) => assert!(what.contains("bench.shuffled"), "{what}"),
        other => panic!("{other:?}"),
    }
    // What was measured before stays.
    let csv = fs::read_to_string(folder.path().join("sort.csv")).unwrap();
    assert_eq!(csv.lines().count(), 2, "{csv}");
}
