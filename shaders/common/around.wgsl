// Trilinear interpolation between the eight cell centres around a position, clamped to the range of the cells; for kernels that sample
// several fields at one position. The importing kernel declares level: Layout.
#import layout

struct Around {
    // Fractions between the cells along each axis.
    f: vec3<f32>,
    // Index of the lowest of the eight cells in the device layout.
    low: u32,
}

// at: position in cells, x / dx.
fn around(at: vec3<f32>) -> Around {
    let top = vec3<f32>(level.cells) - 1.0;
    let index = clamp(at - 0.5, vec3<f32>(), top);
    let low = min(floor(index), max(top - 1.0, vec3<f32>()));
    let base = vec3<u32>(low);
    return Around(index - low, 4u * (level.stride_z * (base.z + 1u) + level.stride_y * base.y) + base.x);
}

// The four of the eight cells on the minus side along x. Each other one follows one of them.
fn minus_cells(place: Around) -> vec4<u32> {
    let row = 4u * level.stride_y;
    let slab = 4u * level.stride_z;
    return place.low + vec4<u32>(0u, row, slab, slab + row);
}

// The value between those of the cells on the minus and on the plus side along x.
fn interpolate(minus: vec4<f32>, plus: vec4<f32>, f: vec3<f32>) -> f32 {
    let along_x = mix(minus, plus, f.x);
    let along_xy = mix(along_x.xz, along_x.yw, f.y);
    return mix(along_xy.x, along_xy.y, f.z);
}
