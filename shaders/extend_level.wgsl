// redistance and liquid_distance with a level and bodies: extends the level into cells without one (see extension).
// Three passes, each reading the result of the last. One thread per quad of the band.
// level, step. band_args, band_list, band_flags: the band. open: apertures of the minus faces. distance_in,
// distance_out: cells.
#import dispatch
#import extension

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> band_flags: array<u32>;
@group(0) @binding(5) var<storage, read> open: array<f32>;
@group(0) @binding(6) var<storage, read> distance_in: array<f32>;
@group(0) @binding(7) var<storage, read_write> distance_out: array<f32>;

// The rule of a level, whose slopes are smooth.
const FLAT_PAIRS = 0.0;
const OVERSHOOT = 1.0;

@compute @workgroup_size(WG_SIZE)
fn extend_level(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let first = 4u * band_list[index];
    for (var cell = first; cell < first + 4u; cell++) {
        var phi = distance_in[cell];
        if phi >= UNKNOWN {
            phi = from_neighbours(cell, false);
        }
        // Transport and volumes interpolate between cells on both sides of closed faces.
        if phi >= UNKNOWN {
            phi = from_neighbours(cell, true);
        }
        distance_out[cell] = phi;
    }
}
