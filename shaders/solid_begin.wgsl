// PCG for solids, start of a refinement step: the residual of the outer loop, scaled to norm 1, becomes the right-hand side of a correction that
// starts from zero. One thread per node.
// rows. norms: see refine. outer: residual of the outer loop. r: scaled residual, out. search: direction, then correction, both zero.
#import dispatch
#import real
#import refine
#import rows

@group(0) @binding(0) var<uniform> rows: Rows;
@group(0) @binding(1) var<storage, read> norms: array<Real>;
@group(0) @binding(2) var<storage, read> outer: array<Real4>;
@group(0) @binding(3) var<storage, read_write> r: array<Real4>;
@group(0) @binding(4) var<storage, read_write> search: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn solid_begin(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= rows.n_nodes {
        return;
    }
    r[node] = outer[node] / norms[SCALE];
    search[node] = Real4();
    search[rows.n_nodes + node] = Real4();
}
