//! `clip`, `right_hand_side` and `extrapolate` beside obstacles that move: what the host clipped arrives on the device as it is, and whole
//! steps are those of the f64 path.

use cutwater::effects::Effects;
use cutwater::fields::{ClipBuffers, ClipSize, LiquidBuffers, LiquidPlan};
use cutwater::geometry::{MovingWall, SolidClip, obstacle_cut};
use cutwater::gpu::{Real, Recorder};
use cutwater::measure::compare::compare;
use cutwater::scene::Scene;
use cutwater::sim::{Backend, Simulation, solids_of};
use cutwater::stages;
use cutwater::state::SolveStatus;

use crate::common::{adapter, gpu, scene_from};
use crate::moving_obstacles::squeezed_vessel;

/// A paddle that turns, a tank that drifts and a post that stands, in water; and more.
fn scene(more: &str) -> Scene {
    let text = format!(
        "[domain]\nsize = [1.0, 1.0, 1.0]\ncells = [14, 14, 14]\n[time]\nduration = 1.0\n\
         [liquid]\n[[liquid.region]]\nbox = {{ min = [0, 0, 0], max = [1, 0.55, 1] }}\n\
         [[obstacle]]\nsphere = {{ centre = [0.75, 0.2, 0.3], radius = 0.11 }}\n\
         [[obstacle]]\nbox = {{ min = [0.3, 0.25, 0.35], max = [0.6, 0.4, 0.75] }}\n\
         keyframes = [{{ t = 0 }}, {{ t = 1, translate = [0.3, 0.1, 0], rotate = {{ axis = [0.2, 1, 0.4], degrees = 200 }} }}]\n\
         [[obstacle]]\nbox = {{ min = [0.06, -1, 0.09], max = [0.93, 3, 0.94] }}\ninside_out = true\n\
         keyframes = [{{ t = 0 }}, {{ t = 0.5, translate = [0.04, 0, 0.03] }}]\n{more}"
    );
    scene_from(&text, &[])
}

const BLOCK: &str = "[[solid]]\nname = \"block\"\nmesh = { box = { size = [0.2, 0.2, 0.2], cells = [2, 2, 2] } }\n\
     placement = { translate = [0.7, 0.6, 0.65] }\ndensity = 600.0\nyoung = 1e5\npoisson = 0.3\n";

#[test]
fn fields_are_those_of_the_clipping() {
    let Some(gpu) = gpu() else { return };
    for more in ["", BLOCK] {
        let scene = scene(more);
        let (grid, solids) = (scene.grid(), solids_of(&scene).unwrap());
        let plan =
            LiquidPlan { grid, effects: Effects::of(&scene), n_markers: 1, cfl: scene.time.cfl, real: Real::F32 };
        let obstacles = obstacle_cut(&scene, &grid).unwrap();
        let clips: Vec<SolidClip> = [0.0, 0.13, 0.9, 0.02, 5.0]
            .map(|time| {
                let mut clip = SolidClip::new(&grid, obstacles.clone(), &scene.solver);
                clip.move_obstacles(time, 0.01);
                clip.clip(&solids.moved(&solids.initial_state(&scene).0));
                clip
            })
            .into();
        let sizes = clips.iter().map(|clip| ClipSize::of(&grid, clip, 0));
        let size = sizes.reduce(ClipSize::joined).unwrap();
        let buffers = LiquidBuffers::new(gpu, plan).unwrap();
        buffers.write_cut_cells(gpu, &obstacles.cut);
        let mut on_device = ClipBuffers::new(gpu, &grid, size).unwrap();
        let stage = stages::clip(gpu, &buffers, &on_device).unwrap();
        let walls = stages::extrapolate(gpu, &buffers, Some((&on_device, None))).unwrap();
        let first = on_device.cut(&clips[0]);
        on_device.write(gpu, (&clips[0], first), &solids.triangles, true);
        for (number, clip) in clips.iter().enumerate() {
            let what = format!("{} solids, clipping {number}", solids.bodies.len());
            let cut = on_device.cut(clip);
            assert!(on_device.fits(&cut), "{what}");
            on_device.write(gpu, (clip, cut), &solids.triangles, false);
            let mut recorder = Recorder::new(gpu);
            stage.record(&mut recorder);
            // The band is empty: only the velocities of the walls are made.
            walls.record(&mut recorder);
            recorder.submit();
            let expected = LiquidBuffers::new(gpu, plan).unwrap();
            expected.write_cut_cells(gpu, clip.cut_cells());
            let open = [&buffers, &expected].map(|b| gpu.download(&b.open).unwrap());
            assert!(open[0] == open[1], "{what}: open fractions");
            let distance = [&buffers, &expected].map(|b| gpu.download(&b.obstacles.solid_distance).unwrap());
            assert!(distance[0] == distance[1], "{what}: distances");

            let padded = grid.padded();
            let mut taken = vec![0.0f32; padded.len()];
            for &(cell, flux) in clip.obstacles().flux() {
                taken[padded.index(grid.cell_at(cell))] = (flux / (grid.dx * grid.dx)) as f32;
            }
            let flux = gpu.download(buffers.obstacle_flux.as_ref().unwrap()).unwrap();
            assert!(flux == taken, "{what}: what obstacles take up");
            assert_eq!(taken.iter().any(|&flux| flux != 0.0), number < 4, "{what}");

            let words = gpu.download(&on_device.walls).unwrap();
            let mut beside = 0;
            for place in clip.moving_walls() {
                let index = padded.index(grid.cell_at(place.cell()));
                let (word, lane) = (words[index / 4], index % 4);
                assert_eq!(word >> lane & 1, 1, "{what}, cell {}", place.cell());
                let MovingWall::Obstacle { velocity, .. } = place else {
                    continue;
                };
                let before = (word & ((1 << lane) - 1)).count_ones();
                let at = padded.quads + 3 * ((word >> 5) + before) as usize;
                let found = [0, 1, 2].map(|axis| f32::from_bits(words[at + axis]));
                assert_eq!(found, velocity.as_vec3().to_array(), "{what}, cell {}", place.cell());
                beside += 1;
            }
            assert!(beside > 100, "{what}: {beside} cells beside obstacles that move");
        }
    }
}

#[test]
fn steps_are_those_of_the_twins() {
    let Some(_) = gpu() else { return };
    let weak = format!("{BLOCK}[solver]\npressure_on_patches = \"gradient\"\n");
    for (name, more) in [("liquid", ""), ("both", BLOCK), ("gradient", &weak)] {
        let scene = scene(more);
        let comparison = compare(&scene, 2, &adapter(), &mut |_, _| {}).unwrap();
        for row in &comparison.rows {
            assert!(!row.breached(), "{name}: {} {}: {:?}", row.stage, row.quantity, row.worst);
        }
        assert!(comparison.rows.iter().any(|row| row.stage == "clip" && row.count > 0), "{name}");
    }
}

#[test]
fn a_vessel_that_shrinks_is_told() {
    let Some(_) = gpu() else { return };
    let scene = squeezed_vessel();
    let mut simulation = Simulation::new(&scene, &Backend::Gpu(adapter())).unwrap();
    let liquid = simulation.step().unwrap().liquid.unwrap();
    assert_eq!(liquid.closed_components, 1);
    assert_eq!(liquid.solve.status, SolveStatus::Incompatible);
}
