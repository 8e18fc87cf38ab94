// Outer loop of the coupled solve, for nodes: r = P (rhs - S v + J^T p), over the mass rate of a cell, and per thread |r|^2, the squared
// norm of the terms of rhs with |P J^T p|^2, free directions and |D v|^2.
// coupling, words, node_pairs, flags: see coupling_force. freedom: see freedom. sums: partials of solid_residual. p: potential, m/s.
// outer: P (rhs - S v), N, in; r, m/s, out. partials: those of the wet quads, then of the nodes.
#import coupling_force
#import dispatch
#import freedom
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read> node_pairs: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> freedom: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> sums: array<Real4>;
@group(0) @binding(6) var<storage, read> p: array<Real4>;
@group(0) @binding(7) var<storage, read_write> outer: array<Real4>;
@group(0) @binding(8) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn coupled_residual(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= coupling.n_nodes {
        return;
    }
    let mass = Real(coupling.mass);
    let push = free_part(freedom[node], force(node));
    let residual = outer[node].xyz / mass + push;
    outer[node] = Real4(residual, Real(0.0));
    let of_solid = sums[node];
    let squared = mass * mass;
    partials[coupling.n_wet + node] = Real4(dot(residual, residual), of_solid.y / squared + dot(push, push), of_solid.z, of_solid.w / squared);
}
