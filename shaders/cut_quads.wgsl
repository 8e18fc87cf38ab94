// clip, first of two: scatters apertures, distances and open faces of the cut quads, and those of static obstacles to
// quads no longer cut.
// One thread per quad.
// clipped, entries: see cut_quad. open: apertures of the minus faces. solid_distance: m. valid: open faces (see
// valid), in place. walls: see moving_walls.
#import cut_quad
#import dispatch
#import lanes
#import layout
#import valid

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> clipped: Clipped;
@group(0) @binding(2) var<storage, read> entries: array<CutQuad>;
@group(0) @binding(3) var<storage, read_write> open: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> solid_distance: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> valid: array<u32>;
@group(0) @binding(6) var<storage, read_write> walls: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn cut_quads(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= clipped.n_quads {
        return;
    }
    let quad = entries[index].quad;
    var is_open = 0u;
    var slivers = false;
    for (var axis = 0u; axis < 3u; axis++) {
        let fractions = entries[index].open[axis];
        open[axis * level.quads + quad] = fractions;
        is_open |= lane_bits(fractions > vec4<f32>()) << (4u * axis);
        slivers |= any((fractions > vec4<f32>()) & (fractions < vec4<f32>(SLIVER)));
    }
    valid[quad] = (valid[quad] & VALID) | is_open << OPEN | select(0u, SLIVERS, slivers);
    solid_distance[quad] = entries[index].distance;
    walls[quad] = entries[index].walls;
}
