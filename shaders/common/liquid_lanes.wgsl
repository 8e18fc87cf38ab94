// Lanes with liquid and the faces between them. The importing kernel declares level: Layout, liquid_distance:
// array<vec4<f32>> (m) and open: array<vec4<f32>> (face apertures).
// cell: that of the first lane of the quad.
#import lanes

// Lanes inside the domain with phi < 0.
fn liquid_lanes(quad: u32, cell: vec3<i32>) -> vec4<bool> {
    return lanes_inside(cell, vec3<i32>(level.cells)) & (liquid_distance[quad] < vec4<f32>());
}

// Lanes whose minus face along an axis is open.
fn open_lanes(axis: u32, quad: u32) -> vec4<bool> {
    return open[axis * level.quads + quad] > vec4<f32>();
}

fn quad_stride(axis: u32) -> u32 {
    return select(level.stride_z, level.stride_y, axis == 1u);
}

// Lanes with liquid in the cells before (towards minus) and after along an axis.
fn liquid_before(axis: u32, quad: u32, cell: vec3<i32>) -> vec4<bool> {
    if axis == 0u {
        return vec4<bool>(liquid_lanes(quad - 1u, cell - vec3<i32>(4, 0, 0)).w, liquid_lanes(quad, cell).xyz);
    }
    let step = vec3<i32>(vec3<u32>(axis) == vec3<u32>(0u, 1u, 2u));
    return liquid_lanes(quad - quad_stride(axis), cell - step);
}
fn liquid_after(axis: u32, quad: u32, cell: vec3<i32>) -> vec4<bool> {
    if axis == 0u {
        return vec4<bool>(liquid_lanes(quad, cell).yzw, liquid_lanes(quad + 1u, cell + vec3<i32>(4, 0, 0)).x);
    }
    let step = vec3<i32>(vec3<u32>(axis) == vec3<u32>(0u, 1u, 2u));
    return liquid_lanes(quad + quad_stride(axis), cell + step);
}

// Lanes whose plus face along an axis is open.
fn open_after(axis: u32, quad: u32) -> vec4<bool> {
    let here = open_lanes(axis, quad);
    if axis == 0u {
        return vec4<bool>(here.yzw, open_lanes(0u, quad + 1u).x);
    }
    return open_lanes(axis, quad + quad_stride(axis));
}

// Lanes whose minus face along an axis joins liquid.
fn joined(axis: u32, quad: u32, cell: vec3<i32>) -> vec4<bool> {
    let here = liquid_lanes(quad, cell) & open_lanes(axis, quad);
    if !any(here) {
        return here;
    }
    return here & liquid_before(axis, quad, cell);
}
