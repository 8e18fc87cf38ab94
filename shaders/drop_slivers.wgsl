// extrapolate, first, where bodies cut the grid: faces that are less than a tenth open keep no velocity of their own. One thread per quad
// of the band. level. args, list: the band. open: fractions of the faces. valid: see valid; in place.
#import dispatch
#import layout
#import lanes
#import valid

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> args: array<u32>;
@group(0) @binding(2) var<storage, read> list: array<u32>;
@group(0) @binding(3) var<storage, read> open: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> valid: array<u32>;

// Fractions below it.
const LEAST_OPEN = 0.1;

@compute @workgroup_size(WG_SIZE)
fn drop_slivers(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= args[3] {
        return;
    }
    let quad = list[index];
    let word = valid[quad];
    if (word & VALID) == 0u {
        return;
    }
    var slivers = 0u;
    for (var axis = 0u; axis < 3u; axis++) {
        slivers |= lane_bits(open[axis * level.quads + quad] < vec4<f32>(LEAST_OPEN)) << (4u * axis);
    }
    if (word & slivers) != 0u {
        valid[quad] = word & ~slivers;
    }
}
