// PCG, start of a refinement step: the residual of the outer loop, scaled to norm 1, becomes the right-hand side of a correction that starts
// from zero; the first sweep of the first V-cycle is done on the way.
// level: level 0. sweep: first omega. list, args: active quads. norms: see refine. outer: residual of the outer loop.
// matrix: see level. r: scaled residual, out. search: direction, then correction; the correction becomes 0. z: first sweep, out.
#import dispatch
#import level
#import real
#import inner
#import refine
#import sweep

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<uniform> sweep: Sweep;
@group(0) @binding(2) var<storage, read> list: array<u32>;
@group(0) @binding(3) var<storage, read> args: array<u32>;
@group(0) @binding(4) var<storage, read> norms: array<Real>;
@group(0) @binding(5) var<storage, read> outer: array<Real4>;
@group(0) @binding(6) var<storage, read> matrix: array<Inner4>;
@group(0) @binding(7) var<storage, read_write> r: array<Inner4>;
@group(0) @binding(8) var<storage, read_write> search: array<Inner4>;
@group(0) @binding(9) var<storage, read_write> z: array<Inner4>;

@compute @workgroup_size(WG_SIZE)
fn pcg_begin(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= args[level.args + 3u] {
        return;
    }
    let q = list[ix] & ~UNIFORM;
    let scaled = Inner4(outer[q] / norms[SCALE]);
    r[q] = scaled;
    search[q] = Inner4();
    search[level.shape.quads + q] = Inner4();
    z[q] = Inner(sweep.omega) * matrix[INV_DIAGONAL * level.shape.total + q] * scaled;
}
