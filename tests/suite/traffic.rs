//! Waits, submissions, dispatches and bytes of the first sub-steps of nine scenes, against a table of what they were: they may only fall.

use cutwater::gpu::Traffic;
use cutwater::scene::Scene;
use cutwater::sim::{Backend, Simulation};

use crate::common::{adapter, gpu, root};

const SUB_STEPS: usize = 3;

/// Traffic of the first [`SUB_STEPS`] sub-steps.
fn traffic(name: &str, scale: f64, overrides: &[String]) -> Traffic {
    let file = root().join(format!("scenes/{name}.toml"));
    let scene = Scene::load(&file, overrides, scale).unwrap();
    let backend = Backend::Gpu(adapter());
    let mut simulation = Simulation::new(&scene, &backend).unwrap();
    let before = simulation.gpu().unwrap().traffic();
    for _ in 0..SUB_STEPS {
        simulation.step().unwrap();
    }
    simulation.gpu().unwrap().traffic().since(before)
}

/// Rows of tests/data/traffic.csv: case, scene, scale, setting, whether the adapter has f64, then the counts. A smaller count is an
/// improvement to write down; a larger one is a regression. `CUTWATER_TRAFFIC=FILE` writes the table of this adapter.
#[test]
fn counts_of_the_scenes_do_not_rise() {
    let Some(gpu) = gpu() else { return };
    let text = std::fs::read_to_string(root().join("tests/data/traffic.csv")).unwrap();
    let mut lines = text.lines();
    let head = lines.next().unwrap();
    let mut measured = vec![head.to_owned()];
    let (mut worse, mut better) = (Vec::new(), Vec::new());
    for line in lines {
        let cells: Vec<&str> = line.split(',').collect();
        let [case, scene, scale, setting, f64] = cells[..5] else { panic!("{line}") };
        if (f64 == "yes") != gpu.has_f64() {
            continue;
        }
        let overrides: Vec<String> = match setting {
            "" => Vec::new(),
            _ => vec![setting.to_owned()],
        };
        let found = traffic(scene, scale.parse().unwrap(), &overrides);
        let counts = [found.waits, found.submissions, found.dispatches, found.bytes_up, found.bytes_down];
        let numbers = counts.map(|count| count.to_string()).join(",");
        measured.push(format!("{},{numbers}", cells[..5].join(",")));
        for ((name, count), before) in head.split(',').skip(5).zip(counts).zip(&cells[5..]) {
            let before: u64 = before.parse().unwrap();
            let told = format!("{case}: {name} {count}, was {before}");
            match count.cmp(&before) {
                std::cmp::Ordering::Greater => worse.push(told),
                std::cmp::Ordering::Less => better.push(told),
                std::cmp::Ordering::Equal => {}
            }
        }
    }
    assert_eq!(measured.len(), 1 + 9, "nine scenes on every kind of adapter");
    if let Ok(file) = std::env::var("CUTWATER_TRAFFIC") {
        std::fs::write(file, measured.join("\n") + "\n").unwrap();
    }
    println!("fell: {better:#?}");
    assert!(worse.is_empty(), "{worse:#?}");
}
