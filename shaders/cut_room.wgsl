// clip with markers, second of two: the lanes of those quads with room for markers. One thread per quad.
// clipped, entries: see cut_quad. occupied: see classes, in place.
#import classes
#import cut_quad
#import dispatch
#import lanes
#import layout

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> clipped: Clipped;
@group(0) @binding(2) var<storage, read> entries: array<CutQuad>;
@group(0) @binding(3) var<storage, read_write> occupied: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn cut_room(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= clipped.n_quads {
        return;
    }
    let quad = entries[index].quad;
    let exists = lanes_inside(quad_cell(level, quad), vec3<i32>(level.cells));
    let room = lane_bits(exists & (entries[index].distance >= vec4<f32>()));
    occupied[quad] = (occupied[quad] & ~15u) | (~room & 15u);
}
