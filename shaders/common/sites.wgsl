// Sites for markers: eight per cell, jittered anew in every sub-step (reference/marker_band.rs).
// The importing kernel declares level: Layout and level_step: LevelStep.
#import layout
#import hash
#import level_step

const SITES = 8u;
// Margin without jitter on each side of a site, as a fraction of its edge.
const SITE_MARGIN = 0.02;

// Hash of seed, sub-step and cell.
fn hash_of_cell(cell: vec3<u32>) -> u32 {
    let number = cell.x + level.cells.x * (cell.y + level.cells.y * cell.z);
    return scatter(scatter(scatter(level_step.seed) ^ level_step.number) ^ number);
}

// Position of a site, cells.
fn site(cell: vec3<u32>, of_cell: u32, number: u32) -> vec3<f32> {
    let of_site = scatter(of_cell ^ number);
    var within: vec3<f32>;
    for (var axis = 0u; axis < 3u; axis++) {
        // The upper 24 bits, scaled to [0, 1).
        let jitter = f32(scatter(of_site ^ axis) >> 8u) / 16777216.0;
        within[axis] = 0.5 * (f32(number >> axis & 1u) + SITE_MARGIN + (1.0 - 2.0 * SITE_MARGIN) * jitter);
    }
    return vec3<f32>(cell) + within;
}
