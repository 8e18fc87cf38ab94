// PCG: q = B s, and per thread s . q, r . q, q . q and r . r.
// level: level 0. list, args: active quads. matrix: see level. x: search direction s. r: residual. q_out: q. partials: sums.
#import dispatch
#import stencil

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> args: array<u32>;
@group(0) @binding(3) var<storage, read> matrix: array<Inner4>;
@group(0) @binding(4) var<storage, read> x: array<Real4>;
@group(0) @binding(5) var<storage, read> r: array<Real4>;
@group(0) @binding(6) var<storage, read_write> q_out: array<Real4>;
@group(0) @binding(7) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn pcg_apply(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= args[level.args + 3u] {
        return;
    }
    let entry = list[ix];
    let q = entry & ~UNIFORM;
    let row = row_of(level, q, (entry & UNIFORM) != 0u);
    q_out[q] = row.bx;
    let residual = r[q];
    partials[ix] = Real4(dot(row.x, row.bx), dot(residual, row.bx), dot(row.bx, row.bx), dot(residual, residual));
}
