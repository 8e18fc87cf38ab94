//! `bench device`: a positive row per quantity, in both files.

use std::fs;

use cutwater::measure::bench::device::measure;

use crate::bench::settings;
use crate::common::gpu;

#[test]
fn every_quantity_has_a_row() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let table = measure(gpu, &settings(folder.path(), 1), &mut |_| ()).unwrap();
    let mut quantities = vec!["copy_bandwidth", "f32_rate"];
    quantities.extend(gpu.has_f64().then_some("f64_rate"));
    quantities.extend(["launch", "indirect_launch", "submission", "wait", "read_back"]);
    let rows = table.rows("device").iter();
    assert_eq!(rows.map(|row| row.text("quantity")).collect::<Vec<_>>(), quantities);
    // A difference of two times may be zero on a busy machine; everything else takes time.
    let differences = ["launch", "indirect_launch", "submission"];
    for row in table.rows("device") {
        let least = if differences.contains(&row.text("quantity")) { 0.0 } else { f64::MIN_POSITIVE };
        assert!(
            row.number("min") >= least
                && row.number("min") <= row.number("median")
                && row.number("median") <= row.number("max"),
            "{row:?}"
        );
    }
    let csv = fs::read_to_string(folder.path().join("device.csv")).unwrap();
    assert!(csv.starts_with("quantity,unit,median,min,max\n"), "{csv}");
    assert_eq!(csv.lines().count(), 1 + quantities.len());
    let json = fs::read_to_string(folder.path().join("device.json")).unwrap();
    let json = crate::common::json(json);
    assert_eq!(json["adapter"], gpu.report().name);
}
