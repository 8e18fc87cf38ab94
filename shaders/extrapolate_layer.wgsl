// extrapolate, one layer: a face without a velocity receives the mean over its nearest valid neighbours of the same
// axis. These are beside it, else across an edge, else across a corner.
// Valid faces are never written and others never read, so the order of the threads does not matter. One thread per
// quad of the band.
// level. band_args, band_list: the band. valid_in, valid_out: see valid. velocity: faces, m/s, in place.
#import dispatch
#import face_marks
#import layout
#import lanes
#import valid

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> valid_in: array<u32>;
@group(0) @binding(4) var<storage, read_write> valid_out: array<u32>;
@group(0) @binding(5) var<storage, read_write> velocity: array<f32>;

// Sum and number of the marked ones of four faces. The others read `own`, which no other thread writes.
fn sum_of(marks: vec4<u32>, bit: u32, faces: vec4<u32>, own: u32) -> vec2<f32> {
    let on = (marks >> vec4<u32>(bit) & vec4<u32>(1u)) != vec4<u32>();
    let at = select(vec4<u32>(own), faces, on);
    let values = vec4<f32>(velocity[at.x], velocity[at.y], velocity[at.z], velocity[at.w]);
    let count = vec4<f32>(on);
    return vec2<f32>(dot(select(vec4<f32>(), values, on), vec4<f32>(1.0)), dot(count, vec4<f32>(1.0)));
}

@compute @workgroup_size(WG_SIZE)
fn extrapolate_layer(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let word = valid_in[quad];
    let here = word & VALID;
    if here == VALID {
        valid_out[quad] = word;
        return;
    }
    let cell = quad_cell(level, quad);
    let n = vec3<i32>(level.cells);
    let wanted = faces_inside(cell) & ~here;
    let has_before = cell.x > 0;
    let has_after = cell.x + 4 <= n.x;
    let below = cell.y > 0;
    let above = cell.y < n.y;
    // Rows beside this one along y and along z; across an edge: along both.
    let y = level.stride_y;
    let z = level.stride_z;
    let beside_exist = vec4<bool>(below, above, true, true);
    let across_exist = vec4<bool>(below, above, below, above);
    let beside_quads = vec4<u32>(quad - y, quad + y, quad - z, quad + z);
    let across_quads = vec4<u32>(quad - y - z, quad + y - z, quad - y + z, quad + y + z);
    let sides = sides_of(quad, cell, here);
    let row = sides.row;
    let beside = sides.beside;
    let by_side = any_of(row | beside) & wanted;
    var beside_before = vec4<u32>();
    var beside_after = vec4<u32>();
    var across = vec4<u32>();
    var across_before = vec4<u32>();
    var across_after = vec4<u32>();
    if by_side != wanted {
        beside_before = before(beside, marks(beside_quads - 1u, beside_exist & vec4<bool>(has_before)));
        beside_after = after(beside, marks(beside_quads + 1u, beside_exist & vec4<bool>(has_after)));
        across = marks(across_quads, across_exist);
        across_before = before(across, marks(across_quads - 1u, across_exist & vec4<bool>(has_before)));
        across_after = after(across, marks(across_quads + 1u, across_exist & vec4<bool>(has_after)));
    }
    let by_edge = (any_of(beside_before) | any_of(beside_after) | any_of(across)) & wanted & ~by_side;
    let by_corner = (any_of(across_before) | any_of(across_after)) & wanted & ~by_side & ~by_edge;
    var reached = by_side | by_edge | by_corner;
    valid_out[quad] = word | reached;
    while reached != 0u {
        let bit = firstTrailingBit(reached);
        reached &= reached - 1u;
        let first = 4u * (bit / 4u * level.quads) + bit % 4u;
        let face = first + 4u * quad;
        let beside_faces = first + 4u * beside_quads;
        let across_faces = first + 4u * across_quads;
        var sum: vec2<f32>;
        if (by_side >> bit & 1u) != 0u {
            sum = sum_of(row, bit, vec4<u32>(face - 1u, face + 1u, face, face), face)
                + sum_of(beside, bit, beside_faces, face);
        } else if (by_edge >> bit & 1u) != 0u {
            sum = sum_of(beside_before, bit, beside_faces - 1u, face) + sum_of(beside_after, bit, beside_faces + 1u, face)
                + sum_of(across, bit, across_faces, face);
        } else {
            sum = sum_of(across_before, bit, across_faces - 1u, face) + sum_of(across_after, bit, across_faces + 1u, face);
        }
        velocity[face] = sum.x / sum.y;
    }
}
