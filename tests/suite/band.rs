//! The band: tiles around the liquid, the list, and what leaves it.

use cutwater::fields::Tiles;
use cutwater::gpu::Recorder;
use cutwater::stages::band;

use crate::common::gpu;
use crate::liquid_case::{Case, cases};

/// Whether a quad lies within reach of a tile that holds one of the cells, by the definition.
fn near(case: &Case, tiles: &Tiles, cells: &[[usize; 3]], ijk: [usize; 3]) -> bool {
    cells.iter().any(|cell| {
        (0..3).all(|a| (cell[a] / 8).abs_diff(ijk[a] / 8) <= tiles.reach as usize) && ijk[1] <= case.grid.cells[1]
    })
}

fn marker_cells(case: &Case) -> Vec<[usize; 3]> {
    let n = case.grid.cells;
    let cell = |x: &[f64; 3]| std::array::from_fn(|a| ((x[a] / case.grid.dx) as usize).min(n[a] - 1));
    case.state.markers.iter().map(cell).collect()
}

#[test]
fn the_band_is_every_quad_within_reach_of_a_marker() {
    let Some(gpu) = gpu() else { return };
    for case in cases() {
        let buffers = case.upload(gpu);
        case.band(gpu, &buffers);
        let flags = gpu.download(&buffers.band_flags).unwrap();
        let tiles = buffers.plan.tiles();
        let cells = marker_cells(&case);
        let mut expected = Vec::new();
        for quad in 0..buffers.padded.quads {
            let slab = quad / buffers.padded.stride_z;
            let row = quad % buffers.padded.stride_z / buffers.padded.stride_y;
            let inside = (1..=case.grid.cells[2] + 1).contains(&slab);
            let i = 4 * (quad % buffers.padded.stride_y);
            if inside && near(&case, &tiles, &cells, [i, row, slab - 1]) {
                expected.push(quad as u32);
            }
        }
        let n = gpu.download(&buffers.band_args).unwrap()[3] as usize;
        let list = gpu.download(&buffers.band_list).unwrap();
        assert_eq!(list[..n], expected, "{}: list", case.name);
        let flagged: Vec<u32> = (0..flags.len() as u32).filter(|&quad| flags[quad as usize] != 0).collect();
        assert_eq!(flagged, expected, "{}: flags", case.name);
    }
}

#[test]
fn what_leaves_the_band_is_put_back_to_air() {
    let Some(gpu) = gpu() else { return };
    let mut case = cases().into_iter().find(|case| case.name == "far corner").unwrap();
    let buffers = case.upload(gpu);
    let band = band(gpu, &buffers, None).unwrap();
    let record = || {
        let mut recorder = Recorder::new(gpu);
        band.record(&mut recorder);
        recorder.submit();
    };
    record();
    let before = gpu.download(&buffers.band_flags).unwrap();
    // As if all of it were deep in the liquid.
    gpu.upload(&buffers.liquid_distance, &vec![-1.0; buffers.padded.len()]);
    let valid = gpu.download(&buffers.valid).unwrap();
    let moving: Vec<u32> = valid.iter().map(|word| word | 0xfff).collect();
    gpu.upload(&buffers.valid, &moving);
    gpu.upload(&buffers.valid_next, &moving);
    // The marker jumps to the other end of the domain.
    let markers = buffers.markers.as_ref().unwrap();
    let end = case.grid.size() - 0.5 * case.grid.dx;
    case.state.markers = vec![end.to_array()];
    let [x, y, z] = end.to_array().map(|x| x as f32);
    gpu.upload(markers, &[[x, y, z, 1.0]]);
    let occupied = buffers.occupied.as_ref().unwrap();
    let words = gpu.download(occupied).unwrap();
    let unmarked: Vec<u32> = words.iter().map(|word| word & 15).collect();
    gpu.upload(occupied, &unmarked);
    record();
    let after = gpu.download(&buffers.band_flags).unwrap();
    let phi = gpu.download(&buffers.liquid_distance).unwrap();
    let words = [&buffers.valid, &buffers.valid_next].map(|words| gpu.download(words).unwrap());
    let mut n_left = 0;
    for quad in 0..buffers.padded.quads {
        let left = before[quad] != 0 && after[quad] == 0;
        n_left += usize::from(left);
        let (distance, low) = if left { (case.grid.dx as f32, valid[quad] & 0xfff) } else { (-1.0, 0xfff) };
        assert_eq!(phi[4 * quad..4 * quad + 4], [distance; 4], "quad {quad}");
        for words in &words {
            assert_eq!(words[quad] & 0xfff, low, "valid faces of quad {quad}");
            assert_eq!(words[quad] >> 16, valid[quad] >> 16, "open faces of quad {quad}");
        }
    }
    assert!(n_left > 0, "nothing left the band");
}
