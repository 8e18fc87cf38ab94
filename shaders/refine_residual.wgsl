// Outer loop: r = b - B x in the precision of the unknowns, and per thread |r|^2, |b|^2 and |D x|^2, D the diagonal of B: see
// refine_accept. Inactive cells get 0.
// level: level 0. list, args, flags: active quads. matrix: see level. x: unknowns. rhs: b. outer: r, out.
#import dispatch
#import stencil

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> args: array<u32>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> matrix: array<Inner4>;
@group(0) @binding(5) var<storage, read> x: array<Real4>;
@group(0) @binding(6) var<storage, read> rhs: array<Real4>;
@group(0) @binding(7) var<storage, read_write> outer: array<Real4>;
@group(0) @binding(8) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn refine_residual(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= args[level.args + 3u] {
        return;
    }
    let entry = list[ix];
    let q = entry & ~UNIFORM;
    let uniform_quad = (entry & UNIFORM) != 0u;
    let row = row_of(level, q, uniform_quad);
    let lanes = (vec4<u32>(flags[q]) & vec4<u32>(1u, 2u, 4u, 8u)) != vec4<u32>();
    let b = select(Real4(), rhs[q], lanes);
    let residual = b - select(Real4(), row.bx, lanes);
    outer[q] = residual;
    let values = select(Real4(), row.x / inv_diagonal(level, q, uniform_quad), lanes);
    partials[ix] = Real4(dot(residual, residual), dot(b, b), Real(0.0), dot(values, values));
}
