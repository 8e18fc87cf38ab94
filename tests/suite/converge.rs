//! `cutwater converge`: runs, tables, chart, refusals.

use std::fs;

use cutwater::measure::converge::{Convergence, Verdict};

use crate::cli::{DAM, complains, folder, list, says};
use crate::common::json;

/// A bar that its weight stretches from rest, without liquid.
const BAR: &str = r#"[domain]
size = [1, 1, 1]
cells = [8, 8, 8]
[time]
duration = 0.1
frames_per_second = 10
fixed_step = 0.025
[[solid]]
name = "bar"
mesh = { box = { size = [0.25, 0.5, 0.25], cells = [2, 4, 2] } }
placement = { translate = [0.5, 0.5, 0.5] }
density = 1000
young = 1e5
poisson = 0.3
[[solid.pin]]
region = { box = { min = [0, 0.74, 0], max = [1, 1, 1] } }
[[probe]]
name = "tip"
node = { solid = "bar", rest_point = [0.5, 0.25, 0.5] }
[[probe]]
name = "hold"
reaction = { solid = "bar" }
"#;

#[test]
fn a_study_has_tables_and_a_chart() {
    let folder = folder(BAR);
    let command = "converge dam.toml --backend cpu --scales 2,0.5,1 --steps --elements";
    let said = says(&folder, command);
    for part in ["probe", "quantity", "order", "verdict", "tip_y", "hold_y", "scale=0.5"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let out = folder.path().join("out/dam_converge");
    let names = list(&out);
    for name in
        ["convergence.csv", "convergence.json", "convergence.svg", "summary.csv", "scale=0.5", "scale=1", "scale=2"]
    {
        assert!(names.iter().any(|there| there == name), "{name}: {names:?}");
    }
    let study = json(fs::read(out.join("convergence.json")).unwrap());
    // Cells and steps shrink with the scale: 4 sub-steps at scale 1.
    assert_eq!(study["scales"], serde_json::json!([0.5, 1.0, 2.0]));
    assert_eq!(study["cell_sizes"], serde_json::json!([0.25, 0.125, 0.0625]));
    assert_eq!(study["sub_steps"], serde_json::json!([2, 4, 8]));
    let overrides = &json(fs::read(out.join("scale=2/manifest.json")).unwrap())["options"]["overrides"];
    let overrides = overrides.to_string();
    for part in ["time.fixed_step=0.0125", ".mesh.box.cells=[4, 8, 4]"] {
        assert!(overrides.contains(part), "{overrides}");
    }
    // Two columns of three and two probes, four quantities each.
    let quantities = study["quantities"].as_array().unwrap();
    assert_eq!(quantities.len(), 6 * 4);
    let mut table = csv::Reader::from_path(out.join("convergence.csv")).unwrap();
    let heads: Vec<String> = table.headers().unwrap().iter().map(str::to_owned).collect();
    let expected =
        ["probe", "unit", "quantity", "scale=0.5", "scale=1", "scale=2", "order", "estimate", "error", "verdict"];
    assert_eq!(heads, expected);
    let rows: Vec<csv::StringRecord> = table.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), quantities.len());
    for (row, quantity) in rows.iter().zip(quantities) {
        assert_eq!(row[0], *quantity["probe"].as_str().unwrap());
        let values = [3, 4, 5].map(|column| row[column].parse::<f64>().unwrap());
        assert_eq!(serde_json::json!(values), quantity["values"]);
        // Only what converges has an estimate, beyond the finest value.
        assert_eq!(&row[9] == "converges", !row[7].is_empty(), "{row:?}");
        if !row[7].is_empty() {
            let estimate: f64 = row[7].parse().unwrap();
            let [_, middle, fine] = values;
            assert!((estimate - fine) * (fine - middle) > 0.0, "{row:?}");
        }
    }
    let chart = fs::read_to_string(out.join("convergence.svg")).unwrap();
    assert!(chart.contains("tip_y, m") && chart.contains("hold_y, N") && chart.contains("cell size"));
    // Again, nothing is left to run.
    let again = says(&folder, command);
    assert_eq!(again.matches("from an earlier sweep").count(), 3, "{again}");
}

#[test]
fn studies_that_cannot_be_are_refused() {
    let bar = folder(BAR);
    let dam = folder(DAM);
    let blind = folder(&DAM.replace("[[probe]]\nname = \"front\"\nfront = { axis = \"x\" }\n", ""));
    for (folder, options, parts) in [
        (&bar, "--scales 1,2", &["--scales 1,2", "three or more", "0.5,1,2"][..]),
        (&bar, "--scales 1,2,2", &["three or more different"]),
        (&bar, "--scales 1,2,-3", &["above zero"]),
        (&dam, "--steps", &["--steps", "neither time.fixed_step", "--set time.fixed_step"]),
        (&dam, "--elements", &["--elements", "no [[solid]]"]),
        (&blind, "", &["has no probe", "[[probe]]"]),
        (&bar, "", &["--scales", "no liquid", "--elements"]),
    ] {
        let told = complains(folder, &format!("converge dam.toml --backend cpu {options}"), 2);
        for part in parts {
            assert!(told.contains(part), "{options}: {told}");
        }
        assert!(!folder.path().join("out").exists(), "{options}");
    }
}

#[test]
fn orders_and_estimates_are_those_of_the_error() {
    for (h, p) in [([2.0, 1.0, 0.5], 1.0), ([0.04, 0.02, 0.01], 2.0), ([3.0, 2.0, 1.0], 1.5), ([1.0, 0.7, 0.6], 0.7)] {
        let f = h.map(|h: f64| 5.0 - 0.3 * h.powf(p));
        let found = Convergence::new(h, f);
        assert_eq!(found.verdict, Verdict::Converges, "{h:?}");
        // The differences cancel up to three digits of 16.
        assert!((found.order.unwrap() - p).abs() < 1e-9, "{found:?}");
        assert!((found.estimate.unwrap() - 5.0).abs() < 1e-9, "{found:?}");
    }
}

#[test]
fn runs_outside_the_asymptotic_range_have_no_estimate() {
    let h = [4.0, 2.0, 1.0];
    for (f, verdict, has_order) in [
        ([1.0, 2.0, 1.5], Verdict::Oscillates, false),
        ([1.0, 1.0, 1.5], Verdict::Oscillates, false),
        ([1.0, 2.0, 4.0], Verdict::Diverges, false),
        ([1.0, 2.0, 3.0], Verdict::Diverges, false),
        ([1.0, 2.0, 2.9], Verdict::TooSlow, true),
        ([1.0, 2.0, 2.05], Verdict::TooFast, true),
        ([1.0, 1.0 + 1e-8, 1.0], Verdict::Constant, false),
        ([0.0, 0.0, 0.0], Verdict::Constant, false),
    ] {
        let found = Convergence::new(h, f);
        assert_eq!(found.verdict, verdict, "{f:?}");
        assert_eq!(found.order.is_some(), has_order, "{f:?}");
        assert_eq!(found.estimate, None, "{f:?}");
    }
}
