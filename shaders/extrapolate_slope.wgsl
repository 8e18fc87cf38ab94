// extrapolate with a level, after the first layer: faces beside the liquid continue its slope. Each valid neighbour u1
// beside a face adds the limited slope of the valid faces u1, u2, u3 in a row behind it to the mean
// (equation, limits and reason in the twin, reference/extrapolate.rs).
// Valid faces are never written and others never used but their own, so the order of the threads does not matter. One
// thread per quad of the band.
// level, step. band_args, band_list: the band. valid_in: before the layer, see valid. velocity: faces, m/s, in place.
#import dispatch
#import face_marks
#import layout
#import lanes
#import step
#import valid

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> valid_in: array<u32>;
@group(0) @binding(5) var<storage, read_write> velocity: array<f32>;

// Valid faces of a quad that may not exist.
fn valid_at(quad: u32, exists: bool) -> u32 {
    return select(0u, valid_in[quad] & VALID, exists);
}

// Faces beside those of a quad on one side.
struct Side {
    // Those with a valid one beside them, and with three in a row.
    one: u32,
    three: u32,
    // To the next one.
    stride: u32,
}

// Sides in other rows: from the marks of the three next quads.
fn side_across(near: u32, middle: u32, far: u32, stride: u32) -> Side {
    return Side(near, near & middle & far, stride);
}

// Sides in the own row: marks of one axis in the quads before, here and after.
fn side_along(words: vec3<u32>, way: i32) -> Side {
    var side = Side(0u, 0u, u32(way));
    for (var axis = 0u; axis < 3u; axis++) {
        let lanes = words >> vec3<u32>(4u * axis) & vec3<u32>(15u);
        let row = lanes.x | lanes.y << 4u | lanes.z << 8u;
        let one = row >> u32(4 + way) & 15u;
        side.one |= one << (4u * axis);
        side.three |= (one & row >> u32(4 + 2 * way) & row >> u32(4 + 3 * way)) << (4u * axis);
    }
    return side;
}

// Slope of a face on one side, m/s, 0 unless three faces in a row are valid, and whether one is.
fn slope(side: Side, bit: u32, face: u32) -> vec2<f32> {
    let has = (vec2<u32>(side.one, side.three) >> vec2<u32>(bit) & vec2<u32>(1u)) != vec2<u32>();
    let stride = select(0u, side.stride, has.y);
    let middle = velocity[face + 2u * stride];
    let near = velocity[face + stride] - middle;
    let far = middle - velocity[face + 3u * stride];
    let rises = has.y && sign(near) == sign(far);
    let central = 0.5 * (abs(near) + abs(far));
    let limited = min(min(central, 2.0 * min(abs(near), abs(far))), step.largest_slope);
    return vec2<f32>(select(0.0, sign(near) * limited, rises), f32(has.x));
}

@compute @workgroup_size(WG_SIZE)
fn extrapolate_slope(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let here = valid_in[quad] & VALID;
    if here == VALID {
        return;
    }
    let cell = quad_cell(level, quad);
    let n = vec3<i32>(level.cells);
    let y = level.stride_y;
    let z = level.stride_z;
    let words = vec3<u32>(valid_at(quad - 1u, cell.x > 0), here, valid_at(quad + 1u, cell.x + 4 <= n.x));
    let before = side_along(words, -1);
    let after = side_along(words, 1);
    let below = side_across(valid_at(quad - y, cell.y > 0), valid_at(quad - 2u * y, cell.y > 1),
        valid_at(quad - 3u * y, cell.y > 2), 0u - 4u * y);
    let above = side_across(valid_at(quad + y, cell.y < n.y), valid_at(quad + 2u * y, cell.y + 1 < n.y),
        valid_at(quad + 3u * y, cell.y + 2 < n.y), 4u * y);
    let behind = side_across(valid_at(quad - z, cell.z > 0), valid_at(quad - 2u * z, cell.z > 1),
        valid_at(quad - 3u * z, cell.z > 2), 0u - 4u * z);
    let front = side_across(valid_at(quad + z, cell.z < n.z), valid_at(quad + 2u * z, cell.z + 1 < n.z),
        valid_at(quad + 3u * z, cell.z + 2 < n.z), 4u * z);
    let any_side = before.one | after.one | below.one | above.one | behind.one | front.one;
    var beside = faces_inside(cell) & ~here & any_side;
    while beside != 0u {
        let bit = firstTrailingBit(beside);
        beside &= beside - 1u;
        let face = 4u * (bit / 4u * level.quads + quad) + bit % 4u;
        var sum = slope(before, bit, face);
        sum += slope(after, bit, face);
        sum += slope(below, bit, face);
        sum += slope(above, bit, face);
        sum += slope(behind, bit, face);
        sum += slope(front, bit, face);
        velocity[face] += sum.x / max(sum.y, 1.0);
    }
}
