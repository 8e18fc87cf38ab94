// PCG: the diagonal as preconditioner, for comparison: z = D^-1 r, and r . z per thread.
// level: level 0. list, args: active quads. matrix: see level. r: in. z, partials: out.
#import dispatch
#import level
#import real

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> args: array<u32>;
@group(0) @binding(3) var<storage, read> matrix: array<Real4>;
@group(0) @binding(4) var<storage, read> r: array<Real4>;
@group(0) @binding(5) var<storage, read_write> z: array<Real4>;
@group(0) @binding(6) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn pcg_jacobi(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= args[level.args + 3u] {
        return;
    }
    let q = list[ix] & ~UNIFORM;
    let residual = r[q];
    let scaled = matrix[INV_DIAGONAL * level.shape.total + q] * residual;
    z[q] = scaled;
    partials[ix] = Real4(dot(residual, scaled), Real(0.0), Real(0.0), Real(0.0));
}
