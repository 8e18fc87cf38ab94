// Outer loop, before the first refinement step: what of the unknowns is free starts from zero, what is held keeps its value, and the free part
// of v* becomes the first correction on trial. One thread per node.
// rows. freedom: see freedom. velocity: v*, then the unknowns, m/s, in place. search: direction, then correction, m/s, out.
#import dispatch
#import freedom
#import real
#import rows

@group(0) @binding(0) var<uniform> rows: Rows;
@group(0) @binding(1) var<storage, read> freedom: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> velocity: array<Real4>;
@group(0) @binding(3) var<storage, read_write> search: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn solid_guess(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= rows.n_nodes {
        return;
    }
    let v = velocity[node].xyz;
    let free = free_part(freedom[node], v);
    search[rows.n_nodes + node] = Real4(free, Real(0.0));
    velocity[node] = Real4(v - free, Real(0.0));
}
