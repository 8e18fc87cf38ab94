// Stage closed_components: the first labels, trees whose links are faces with weight: to the cell below in z, else in y, else
// in x, else to itself (the choice of neighbour after Komura 2015).
// level: level 0. list, args, flags: active quads. matrix: see level. labels: out, see components.
#import dispatch
#import edges
#import components

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> args: array<u32>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> matrix: array<Real4>;
@group(0) @binding(5) var<storage, read_write> labels: array<vec4<u32>>;

@compute @workgroup_size(WG_SIZE)
fn components_init(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= args[level.args + 3u] {
        return;
    }
    let entry = list[ix];
    let q = entry & ~UNIFORM;
    let own = vec4<u32>(4u * q) + vec4<u32>(0u, 1u, 2u, 3u);
    let below = own - vec4<u32>(4u * level.shape.stride_z);
    if (entry & UNIFORM) != 0u {
        labels[q] = below;
        return;
    }
    let edges = edges_of(q);
    let lanes = (vec4<u32>(flags[q]) & vec4<u32>(1u, 2u, 4u, 8u)) != vec4<u32>();
    var label = select(vec4<u32>(NONE), own, lanes);
    label = select(label, own - vec4<u32>(1u), edges.x);
    label = select(label, own - vec4<u32>(4u * level.shape.stride_y), edges.y);
    labels[q] = select(label, below, edges.z);
}
