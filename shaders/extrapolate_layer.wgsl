// extrapolate, one layer: a face without a velocity takes the mean over its neighbours of the same axis that have one. Valid
// faces are never written and others never read, so the order of the threads does not matter. One thread per quad of the band.
// level. args, list: the band. valid_in, valid_out: see valid. velocity: faces, m/s, in place.
#import dispatch
#import layout
#import lanes
#import valid

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> args: array<u32>;
@group(0) @binding(2) var<storage, read> list: array<u32>;
@group(0) @binding(3) var<storage, read> valid_in: array<u32>;
@group(0) @binding(4) var<storage, read_write> valid_out: array<u32>;
@group(0) @binding(5) var<storage, read_write> velocity: array<f32>;

// The first and the last lane of each axis.
const FIRST = 0x111u;
const LAST = 0x888u;

@compute @workgroup_size(WG_SIZE)
fn extrapolate_layer(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= args[3] {
        return;
    }
    let quad = list[index];
    let word = valid_in[quad];
    let here = word & VALID;
    if here == VALID {
        valid_out[quad] = word;
        return;
    }
    let cell = quad_cell(level, quad);
    let n = vec3<i32>(level.cells);
    // Faces that exist, and the valid ones among the neighbours; rows and slabs of spare cells lead to other rows and slabs.
    let exist = lane_bits(lanes_inside(cell, face_extents(level, 0u)))
        | lane_bits(lanes_inside(cell, face_extents(level, 1u))) << 4u
        | lane_bits(lanes_inside(cell, face_extents(level, 2u))) << 8u;
    let before = select(0u, valid_in[quad - 1u], cell.x > 0);
    let after = select(0u, valid_in[quad + 1u], cell.x + 4 <= n.x);
    let sides = array<u32, 6>(
        (here << 1u & ~FIRST) | (before >> 3u & FIRST),
        (here >> 1u & ~LAST) | (after << 3u & LAST),
        select(0u, valid_in[quad - level.stride_y], cell.y > 0),
        select(0u, valid_in[quad + level.stride_y], cell.y < n.y),
        valid_in[quad - level.stride_z],
        valid_in[quad + level.stride_z],
    );
    let some = sides[0] | sides[1] | sides[2] | sides[3] | sides[4] | sides[5];
    var reached = some & exist & ~here;
    valid_out[quad] = word | reached;
    let row = 4u * level.stride_y;
    let slab = 4u * level.stride_z;
    while reached != 0u {
        let bit = firstTrailingBit(reached);
        reached &= reached - 1u;
        let face = 4u * (bit / 4u * level.quads + quad) + bit % 4u;
        let neighbours = array<u32, 6>(face - 1u, face + 1u, face - row, face + row, face - slab, face + slab);
        var sum = 0.0;
        var count = 0.0;
        for (var s = 0u; s < 6u; s++) {
            if (sides[s] >> bit & 1u) != 0u {
                sum += velocity[neighbours[s]];
                count += 1.0;
            }
        }
        velocity[face] = sum / count;
    }
}
