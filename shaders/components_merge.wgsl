// Stage closed_components: joins the trees across the faces that the first labels left out (see join). Most such faces close a square of which the other three are faces with weight, and join nothing new.
// level: level 0. list, args, flags: active quads. matrix: see level. labels: in and out, see components.
#import dispatch
#import edges
#import join

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> args: array<u32>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> matrix: array<Real4>;
@group(0) @binding(5) var<storage, read_write> labels: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn components_merge(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= args[level.args + 3u] {
        return;
    }
    let entry = list[ix];
    let q = entry & ~UNIFORM;
    let sy = level.shape.stride_y;
    let sz = level.shape.stride_z;
    if (entry & flags[q - 1u] & flags[q - sy] & flags[q - sz] & UNIFORM) != 0u {
        return;
    }
    let edges = edges_of(q);
    let left_y = vec4<bool>(positive(1u, q - 1u).w, edges.y.xyz);
    let left_z = vec4<bool>(positive(2u, q - 1u).w, edges.z.xyz);
    let known_y = positive(2u, q - sy) & positive(1u, q - sz);
    let known_x = (edges.z & left_z & positive(0u, q - sz)) | (edges.y & left_y & positive(0u, q - sy));
    let join_y = edges.y & edges.z & !known_y;
    let join_x = edges.x & (edges.y | edges.z) & !known_x;
    for (var l = 0u; l < 4u; l++) {
        let cell = 4u * q + l;
        if join_y[l] {
            join(cell, cell - 4u * sy);
        }
        if join_x[l] {
            join(cell, cell - 1u);
        }
    }
}
