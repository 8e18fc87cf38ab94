//! `compare`: the five scenes pass it, and a value that is off does not.

use std::path::Path;

use cutwater::Error;
use cutwater::gpu::AdapterChoice;
use cutwater::measure::compare::{Comparison, compare};
use cutwater::scene::Scene;
use cutwater::sim::Snapshot;

use crate::common::gpu;

fn scene(name: &str, scale: f64, overrides: &[&str]) -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenes/{name}.toml"));
    let overrides: Vec<String> = overrides.iter().map(|&text| text.to_owned()).collect();
    Scene::load(&path, &overrides, scale).unwrap()
}

/// What differs by more than its bound, one per line.
fn breaches(comparison: &Comparison) -> String {
    let rows = comparison.rows.iter().filter(|row| row.breached());
    rows.map(|row| format!("{} {}: {:?}\n", row.stage, row.quantity, row.worst))
        .collect()
}

#[test]
fn all_scenes_pass() {
    if gpu().is_none() {
        return;
    }
    let thin = ["domain.size=[2.0, 1.25, 0.25]", "domain.cells=[16, 10, 2]"];
    let moving = ["liquid.region[0].velocity=[1.0, 0.5, -0.75]"];
    let markers = ["liquid.surface=\"markers\""];
    for (scene, frames) in [
        (scene("dam_break_liquid", 0.25, &[]), 3),
        (scene("drop_into_pool", 0.375, &moving), 2),
        (scene("hydrostatic_block", 0.5, &[]), 2),
        (scene("hydrostatic_block", 0.5, &markers), 2),
        (scene("sphere_half_full", 0.5, &[]), 2),
        (scene("standing_wave", 1.0, &thin), 2),
    ] {
        let comparison = compare(&scene, frames, &AdapterChoice::Best, &mut |_, _| {}).unwrap();
        let found = breaches(&comparison);
        assert!(found.is_empty(), "{}:\n{found}", scene.name);
        assert!(comparison.verdict().is_ok(), "{}", scene.name);
        assert!(comparison.steps >= frames, "{}", scene.name);
        for row in &comparison.rows {
            assert!(
                500 * row.excused <= row.count,
                "{}: {} of {} excused in {} of {}",
                scene.name,
                row.excused,
                row.count,
                row.quantity,
                row.stage
            );
        }
    }
}

/// A change of what was downloaded.
type Change = fn(&mut Snapshot);

/// The first flag that is set.
fn first(flags: &[bool]) -> usize {
    flags.iter().position(|&flag| flag).unwrap()
}

#[test]
fn what_is_off_is_found() {
    if gpu().is_none() {
        return;
    }
    let scene = scene("sphere_half_full", 0.5, &[]);
    let changes: [(&str, &str, Change); 17] = [
        ("advect_markers", "positions", |s| {
            s.markers[7].as_mut().unwrap()[1] += 1e-5;
        }),
        ("advect_markers", "markers dropped", |s| s.markers[7] = None),
        ("advect_velocity", "u*", |s| {
            s.velocity_next[2][first(&s.face_band[2])] += 1e-5;
        }),
        ("forces", "u*", |s| {
            s.velocity_next[0][first(&s.face_band[0])] += 1e-5;
        }),
        ("liquid_distance", "phi", |s| {
            s.liquid_distance[first(&s.band)] += 1e-5
        }),
        ("liquid_distance", "volume rate", |s| {
            s.report.volume_rate += 1e-3
        }),
        ("active_cells", "active", |s| {
            let cell = first(&s.active);
            s.active[cell] = false;
        }),
        ("active_cells", "weights", |s| {
            let face = s.weight[1].iter().position(|&weight| weight > 0.0).unwrap();
            s.weight[1][face] *= 1.0 + 1e-6;
        }),
        ("active_cells", "free-surface terms", |s| {
            let cell = s.dirichlet.iter().position(|&term| term > 0.0).unwrap();
            s.dirichlet[cell] *= 1.0 + 1e-5;
        }),
        ("right_hand_side", "E u* / dx^2", |s| {
            s.rhs[first(&s.active)] += 1e-4
        }),
        ("solve", "true residual", |s| {
            s.potential[first(&s.active)] += 1e-4
        }),
        ("solve", "pressure", |s| {
            for potential in &mut s.potential {
                *potential *= 1.0 + 1e-3;
            }
        }),
        ("write_back", "valid faces", |s| {
            let face = first(&s.valid[1]);
            s.valid[1][face] = false;
        }),
        ("write_back", "u", |s| {
            s.velocity[1][first(&s.valid[1])] += 1e-5
        }),
        ("extrapolate", "u", |s| {
            s.velocity[1][first(&s.face_band[1])] = f64::NAN
        }),
        ("diagnose", "volume", |s| {
            s.report.diagnosis.volume *= 1.0 + 1e-4
        }),
        ("diagnose", "largest speed", |s| {
            s.report.diagnosis.max_speed *= 1.0 + 1e-7
        }),
    ];
    for (stage, quantity, change) in changes {
        let mut listen = |name: &'static str, snapshot: &mut Snapshot| {
            if name == stage {
                change(snapshot);
            }
        };
        let comparison = compare(&scene, 1, &AdapterChoice::Best, &mut listen).unwrap();
        let row = comparison
            .rows
            .iter()
            .find(|row| row.stage == stage && row.quantity == quantity)
            .unwrap();
        assert!(row.breached(), "{stage} {quantity}: {:?}", row.worst);
        let verdict = comparison.verdict();
        assert!(
            matches!(verdict, Err(Error::Check(_))),
            "{stage} {quantity}: {verdict:?}"
        );
        assert_eq!(verdict.unwrap_err().exit_code(), 1, "{stage} {quantity}");
    }
}
