// PCG: x = x + alpha s, r = r - alpha q; the first sweep of the next V-cycle is done on the way.
// level: level 0. sweep: first omega. list, args: active quads. scalars: see pcg. matrix: see level.
// search: direction, then correction. q_in: B s. r: in and out. z: first sweep, out.
#import dispatch
#import level
#import pcg_slots
#import real
#import sweep

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<uniform> sweep: Sweep;
@group(0) @binding(2) var<storage, read> list: array<u32>;
@group(0) @binding(3) var<storage, read> args: array<u32>;
@group(0) @binding(4) var<storage, read> scalars: array<Real>;
@group(0) @binding(5) var<storage, read> matrix: array<Real4>;
@group(0) @binding(6) var<storage, read_write> search: array<Real4>;
@group(0) @binding(7) var<storage, read> q_in: array<Real4>;
@group(0) @binding(8) var<storage, read_write> r: array<Real4>;
@group(0) @binding(9) var<storage, read_write> z: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn pcg_update(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= args[level.args + 3u] {
        return;
    }
    let entry = list[ix];
    let q = entry & ~UNIFORM;
    let alpha = scalars[ALPHA];
    search[level.shape.quads + q] += alpha * search[q];
    let residual = r[q] - alpha * q_in[q];
    r[q] = residual;
    var inv = Real4(Real(1.0) / (Real(6.0) * Real(level.coefficient)));
    if (entry & UNIFORM) == 0u {
        inv = matrix[INV_DIAGONAL * level.shape.total + q];
    }
    z[q] = Real(sweep.omega) * inv * residual;
}
