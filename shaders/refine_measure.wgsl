// Outer loop, before the first refinement step: per thread |b|^2, | |E| |u*| |^2 and the number of unknowns. The unknowns start from zero.
// level: level 0. list, args, flags: active quads. rhs: b, m/s. velocity: u* on the faces, m/s. open: fractions of the faces.
// x: unknowns, out.
#import dispatch
#import level
#import real

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> args: array<u32>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> rhs: array<Real4>;
@group(0) @binding(5) var<storage, read> velocity: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> open: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> x: array<Real4>;
@group(0) @binding(8) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn refine_measure(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= args[level.args + 3u] {
        return;
    }
    let q = list[ix] & ~UNIFORM;
    x[q] = Real4();
    let n = level.shape.quads;
    let y = n + q;
    let z = 2u * n + q;
    let fx = abs(open[q] * velocity[q]);
    let flux = fx + vec4<f32>(fx.yzw, abs(open[q + 1u].x * velocity[q + 1u].x))
        + abs(open[y] * velocity[y]) + abs(open[y + level.shape.stride_y] * velocity[y + level.shape.stride_y])
        + abs(open[z] * velocity[z]) + abs(open[z + level.shape.stride_z] * velocity[z + level.shape.stride_z]);
    let lanes = (vec4<u32>(flags[q]) & vec4<u32>(1u, 2u, 4u, 8u)) != vec4<u32>();
    let b = select(Real4(), rhs[q], lanes);
    let f = select(Real4(), Real4(flux), lanes);
    partials[ix] = Real4(dot(b, b), dot(f, f), Real(countOneBits(flags[q] & 15u)), Real(0.0));
}
