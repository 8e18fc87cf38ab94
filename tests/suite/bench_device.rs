//! `bench device`: a positive row per quantity, in both files.

use std::fs;

use cutwater::measure::bench_device::bench_device;

use crate::common::gpu;

#[test]
fn every_quantity_has_a_row() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let table = bench_device(gpu, 1, folder.path()).unwrap();
    let mut quantities = vec!["copy_bandwidth", "f32_rate"];
    quantities.extend(gpu.has_f64().then_some("f64_rate"));
    quantities.extend([
        "launch",
        "indirect_launch",
        "submission",
        "wait",
        "read_back",
    ]);
    let rows = table.rows.iter();
    assert_eq!(rows.map(|row| row.quantity).collect::<Vec<_>>(), quantities);
    // A difference of two times may be zero on a busy machine; everything else takes time.
    let differences = ["launch", "indirect_launch", "submission"];
    for row in &table.rows {
        let least = if differences.contains(&row.quantity) {
            0.0
        } else {
            f64::MIN_POSITIVE
        };
        assert!(
            row.min >= least && row.min <= row.median && row.median <= row.max,
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
