// Outer loop: x = x + scale dx, with the correction of the refinement step. Inactive cells keep 0.
// level: level 0. list, args, flags: active quads. norms: see refine. search: direction, then correction. x: unknowns.
#import dispatch
#import level
#import real
#import inner
#import refine

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> args: array<u32>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> norms: array<Real>;
@group(0) @binding(5) var<storage, read> search: array<Inner4>;
@group(0) @binding(6) var<storage, read_write> x: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn refine_correct(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= args[level.args + 3u] {
        return;
    }
    let q = list[ix] & ~UNIFORM;
    let lanes = (vec4<u32>(flags[q]) & vec4<u32>(1u, 2u, 4u, 8u)) != vec4<u32>();
    x[q] += select(Real4(), norms[SCALE] * Real4(search[level.shape.quads + q]), lanes);
}
