// PCG for solids: x = x + alpha s, r = r - alpha q. One thread per node.
// rows. scalars: see pcg. search: direction, then correction. q_in: S s. r: in and out.
#import dispatch
#import pcg_slots
#import real
#import rows

@group(0) @binding(0) var<uniform> rows: Rows;
@group(0) @binding(1) var<storage, read> scalars: array<Real>;
@group(0) @binding(2) var<storage, read_write> search: array<Real4>;
@group(0) @binding(3) var<storage, read> q_in: array<Real4>;
@group(0) @binding(4) var<storage, read_write> r: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn solid_update(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= rows.n_nodes {
        return;
    }
    let alpha = scalars[ALPHA];
    search[rows.n_nodes + node] += alpha * search[node];
    r[node] -= alpha * q_in[node];
}
