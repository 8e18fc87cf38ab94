// The four lanes of a quad: neighbours along x, and lanes inside the domain.
#import layout

const LANES = vec4<i32>(0, 1, 2, 3);

// Values one cell before / after each lane, from the quad before / after.
fn shift_up(before: vec4<f32>, here: vec4<f32>) -> vec4<f32> {
    return vec4<f32>(before.w, here.xyz);
}
fn shift_down(here: vec4<f32>, after: vec4<f32>) -> vec4<f32> {
    return vec4<f32>(here.yzw, after.x);
}

// Lanes whose cell is in a box of n cells at the origin.
fn lanes_inside(cell: vec3<i32>, n: vec3<i32>) -> vec4<bool> {
    let row = all(cell.yz >= vec2<i32>()) && all(cell.yz < n.yz);
    let x = vec4<i32>(cell.x) + LANES;
    return vec4<bool>(row) & (x >= vec4<i32>()) & (x < vec4<i32>(n.x));
}

// One more face than cells along the axis of the faces.
fn face_extents(level: Layout, axis: u32) -> vec3<i32> {
    return vec3<i32>(level.cells) + vec3<i32>(vec3<u32>(axis) == vec3<u32>(0u, 1u, 2u));
}

// The lanes as bits, lane 0 lowest.
fn lane_bits(lanes: vec4<bool>) -> u32 {
    return dot(vec4<u32>(lanes), vec4<u32>(1u, 2u, 4u, 8u));
}
fn bit_lanes(bits: u32) -> vec4<bool> {
    return (vec4<u32>(bits) & vec4<u32>(1u, 2u, 4u, 8u)) != vec4<u32>();
}
