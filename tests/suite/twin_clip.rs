//! `clip`: what the host clipped arrives on the device as it is, wherever the solids go, and beside it how fast their surfaces move.

use cutwater::effects::Effects;
use cutwater::fields::{ClipBuffers, ClipSize, LiquidBuffers, LiquidPlan};
use cutwater::geometry::{SolidClip, obstacle_cut};
use cutwater::gpu::{Gpu, Real, RealBuffer, Recorder};
use cutwater::sim::solids_of;
use cutwater::stages;
use glam::DVec3;

use crate::common::{Random, gpu};
use crate::coupled_case::scene;
use crate::liquid_case::EPS;

/// What the stage writes, bit for bit.
type Fields = (Vec<f32>, Vec<f32>, Vec<u32>, Vec<u32>);

fn fields(gpu: &Gpu, buffers: &LiquidBuffers) -> Fields {
    let occupied = buffers.occupied.as_ref();
    (
        gpu.download(&buffers.open).unwrap(),
        gpu.download(&buffers.obstacles.solid_distance).unwrap(),
        gpu.download(&buffers.valid).unwrap(),
        occupied.map_or(Vec::new(), |occupied| gpu.download(occupied).unwrap()),
    )
}

#[test]
fn fields_are_those_of_the_clipping() {
    let Some(gpu) = gpu() else { return };
    for surface in ["markers", "fixed"] {
        let scene = scene(&[&format!("liquid.surface={surface}")]);
        let (grid, solids) = (scene.grid(), solids_of(&scene).unwrap());
        let obstacles = obstacle_cut(&scene, &grid).unwrap();
        let plan =
            LiquidPlan { grid, effects: Effects::of(&scene), n_markers: 1, cfl: scene.time.cfl, real: Real::F32 };
        // Moved far, bent, and where they were; the last but one leaves the grid cut by the obstacle alone.
        let moves: [&dyn Fn(DVec3) -> DVec3; 6] = [
            &|_| DVec3::ZERO,
            &|x| DVec3::new(0.31, -0.2, 0.07) + 0.05 * x,
            &|x| 0.2 * DVec3::new(x.y, x.z * x.x, -x.x),
            &|x| 0.4 * (x - DVec3::new(0.5, 0.4, 0.5)),
            &|_| DVec3::new(30.0, 0.0, 0.0),
            &|_| DVec3::ZERO,
        ];
        let clips: Vec<SolidClip> = moves
            .iter()
            .map(|moved| {
                let mut clip = SolidClip::new(&grid, obstacles.clone(), &scene.solver);
                let displacement = solids.rest.iter().map(|&x| moved(x).to_array());
                clip.clip(&solids.moved(&displacement.collect::<Vec<_>>()));
                clip
            })
            .collect();
        let sizes = clips.iter().map(|clip| ClipSize::of(&grid, clip, 0));
        let room = ClipSize {
            quads: sizes.clone().map(|size| size.quads).sum(),
            places: sizes.map(|size| size.places).max().unwrap(),
            moving_obstacles: false,
        };
        let buffers = LiquidBuffers::new(gpu, plan).unwrap();
        buffers.write_cut_cells(gpu, &obstacles.cut);
        let mut on_device = ClipBuffers::new(gpu, &grid, room).unwrap();
        let stage = stages::clip(gpu, &buffers, &on_device).unwrap();
        let mut random = Random(5);
        let speeds: Vec<f64> =
            (0..4 * solids.rest.len()).map(|_| f64::from(random.uniform(-2.0, 2.0) as f32)).collect();
        let velocity = RealBuffer::new(gpu, "test.velocity", speeds.len(), Real::F32).unwrap();
        velocity.upload(gpu, &speeds);
        let walls = stages::extrapolate(gpu, &buffers, Some((&on_device, Some(&velocity)))).unwrap();
        for (number, clip) in clips.iter().enumerate() {
            let cut = on_device.cut(clip);
            assert!(on_device.fits(&cut));
            on_device.write(gpu, (clip, cut), &solids.triangles, false);
            let mut recorder = Recorder::new(gpu);
            stage.record(&mut recorder);
            // The band is empty: only the velocities of the walls are made.
            walls.record(&mut recorder);
            recorder.submit();
            let expected = LiquidBuffers::new(gpu, plan).unwrap();
            expected.write_cut_cells(gpu, clip.cut_cells());
            let same = fields(gpu, &buffers) == fields(gpu, &expected);
            assert!(same, "{surface}, clipping {number}");

            let words = gpu.download(&on_device.walls).unwrap();
            let padded = grid.padded();
            for cell in 0..grid.n_cells() {
                let index = padded.index(grid.cell_at(cell));
                let (word, lane) = (words[index / 4], index % 4);
                let what = format!("{surface}, clipping {number}, cell {cell}");
                let Some(nearest) = clip.nearest(cell) else {
                    assert_eq!(word >> lane & 1, 0, "{what}");
                    continue;
                };
                assert_eq!(word >> lane & 1, 1, "{what}");
                let before = (word & ((1 << lane) - 1)).count_ones();
                let at = padded.quads + 3 * ((word >> 5) + before) as usize;
                let nodes = solids.triangles[nearest.triangle].iter();
                let twin: DVec3 = nodes
                    .zip(nearest.weights)
                    .map(|(&node, weight)| weight * DVec3::from_slice(&speeds[4 * node as usize..]))
                    .sum();
                for axis in 0..3 {
                    // Three weights, products and sums of speeds up to 2 m/s.
                    let found = f64::from(f32::from_bits(words[at + axis]));
                    let off = (found - twin[axis]).abs();
                    assert!(off <= 8.0 * EPS * 2.0, "{what}: {found} and {twin}");
                }
            }
            // Quads with patches, and no others.
            let mut wet: Vec<usize> = (0..padded.quads).filter(|&q| words[q] & 16 != 0).collect();
            let cells = clip.coupling().cells();
            let mut expected: Vec<usize> = cells.map(|(cell, _)| padded.index(grid.cell_at(cell)) / 4).collect();
            expected.dedup();
            wet.sort_unstable();
            assert_eq!(wet, expected, "{surface}, clipping {number}");
        }
    }
}
