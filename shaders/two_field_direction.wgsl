// Two-field PCG, for nodes: s = z + beta s.
// coupling. scalars: see pcg_slots. z: in. search: direction, in and out.
#import coupling
#import dispatch
#import inner
#import pcg_slots
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> scalars: array<Inner>;
@group(0) @binding(2) var<storage, read> z: array<Real4>;
@group(0) @binding(3) var<storage, read_write> search: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn two_field_direction(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= coupling.n_nodes {
        return;
    }
    search[node] = z[node] + Real(scalars[BETA]) * search[node];
}
