// clip, with pressure_on_patches = "gradient" only: the gradient of the last pressure at the centres of cells with patches, from the open
// neighbours that were unknowns; along an axis without one, and in cells that were none, that of liquid at rest.
// One thread per wet quad. level, slope. coupling, words: see coupling. flags: active lanes of the last sub-step (see active).
// potential: of the last sub-step, m/s. open: fractions of the minus faces now. slopes: four per wet quad, Pa/m, out.
#import coupling
#import dispatch
#import layout
#import pressure_slope
#import real

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> slope: PressureSlope;
@group(0) @binding(2) var<uniform> coupling: Coupling;
@group(0) @binding(3) var<storage, read> words: array<u32>;
@group(0) @binding(4) var<storage, read> flags: array<u32>;
@group(0) @binding(5) var<storage, read> potential: array<Real>;
@group(0) @binding(6) var<storage, read> open: array<f32>;
@group(0) @binding(7) var<storage, read_write> slopes: array<vec4<f32>>;

fn was_active(cell: u32) -> bool {
    return (flags[cell / 4u] >> (cell % 4u) & 1u) == 1u;
}

fn slope_along(axis: u32, cell: u32) -> f32 {
    let stride = 4u * select(select(level.stride_z, level.stride_y, axis == 1u), 0u, axis == 0u) + u32(axis == 0u);
    var sum = Real(0.0);
    var n = Real(0.0);
    if open[4u * axis * level.quads + cell] > 0.0 && was_active(cell - stride) {
        sum += potential[cell] - potential[cell - stride];
        n += Real(1.0);
    }
    if open[4u * axis * level.quads + cell + stride] > 0.0 && was_active(cell + stride) {
        sum += potential[cell + stride] - potential[cell];
        n += Real(1.0);
    }
    if n == Real(0.0) {
        return slope.at_rest[axis];
    }
    return slope.scale * f32(sum / n);
}

@compute @workgroup_size(WG_SIZE)
fn pressure_slopes(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let wet = linear_index(workgroup, lane);
    if wet >= coupling.n_wet {
        return;
    }
    for (var l = 0u; l < 4u; l++) {
        let cell = 4u * words[wet] + l;
        var found = slope.at_rest;
        if was_active(cell) {
            found = vec3<f32>(slope_along(0u, cell), slope_along(1u, cell), slope_along(2u, cell));
        }
        slopes[4u * wet + l] = vec4<f32>(found, 0.0);
    }
}
