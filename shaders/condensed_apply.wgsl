// Condensed operator, for wetted nodes: t = W f, W the part of S^-1 among their components. One thread per wetted node, which reads columns:
// W is symmetric, and neighbours read neighbours.
// wetted. nodes: which they are. inverse: W times the mass rate of a cell, three rows per node. f: per node, J^T s. t: out, at wetted nodes.
#import dispatch
#import real
#import wetted

@group(0) @binding(0) var<uniform> wetted: Wetted;
@group(0) @binding(1) var<storage, read> nodes: array<u32>;
@group(0) @binding(2) var<storage, read> inverse: array<f32>;
@group(0) @binding(3) var<storage, read> f: array<Real4>;
@group(0) @binding(4) var<storage, read_write> t: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn condensed_apply(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let row = linear_index(workgroup, lane);
    if row >= wetted.n {
        return;
    }
    var sum = Real3();
    for (var column = 0u; column < wetted.n; column++) {
        let force = f[nodes[column]].xyz;
        for (var axis = 0u; axis < 3u; axis++) {
            let at = 3u * ((3u * column + axis) * wetted.n + row);
            sum += force[axis] * Real3(vec3<f32>(inverse[at], inverse[at + 1u], inverse[at + 2u]));
        }
    }
    t[nodes[row]] = Real4(sum, Real(0.0));
}
