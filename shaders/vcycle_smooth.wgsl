// V-cycle: one sweep of scheduled-relaxation Jacobi (Yang and Mittal 2014), x_out = x + omega D^-1 (r - B x), out of place.
// level: the level. sweep: omega, and whether the sweep ends the cycle and leaves r . x_out per thread in partials.
// list, args: the level's active quads. matrix: see level. x, r: in. x_out: out.
#import dispatch
#import stencil
#import sweep

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<uniform> sweep: Sweep;
@group(0) @binding(2) var<storage, read> list: array<u32>;
@group(0) @binding(3) var<storage, read> args: array<u32>;
@group(0) @binding(4) var<storage, read> matrix: array<Inner4>;
@group(0) @binding(5) var<storage, read> x: array<Real4>;
@group(0) @binding(6) var<storage, read> r: array<Real4>;
@group(0) @binding(7) var<storage, read_write> x_out: array<Real4>;
@group(0) @binding(8) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn vcycle_smooth(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= args[level.args + 3u] {
        return;
    }
    let entry = list[level.shape.first + ix];
    let q = entry & ~UNIFORM;
    let uniform_quad = (entry & UNIFORM) != 0u;
    let row = row_of(level, q, uniform_quad);
    let residual = r[q];
    let improved = row.x + Real(sweep.omega) * inv_diagonal(level, q, uniform_quad) * (residual - row.bx);
    x_out[q] = improved;
    if sweep.ends_cycle != 0u {
        partials[ix] = Real4(dot(residual, improved), Real(0.0), Real(0.0), Real(0.0));
    }
}
