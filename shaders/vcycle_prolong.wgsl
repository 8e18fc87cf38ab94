// V-cycle: each cell takes the correction of its coarse cell, x = x + P x_coarse, in place.
// level, coarse: the levels. list, args: active quads of the fine level. x: all levels.
#import dispatch
#import level
#import real

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<uniform> coarse: Level;
@group(0) @binding(2) var<storage, read> list: array<u32>;
@group(0) @binding(3) var<storage, read> args: array<u32>;
@group(0) @binding(4) var<storage, read_write> x: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn vcycle_prolong(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= args[level.args + 3u] {
        return;
    }
    let q = list[level.shape.first + ix] & ~UNIFORM;
    let cell = vec3<u32>(quad_cell(level.shape, q - level.shape.first));
    let s = coarse.shape;
    let above = x[s.first + s.stride_z * (cell.z / 2u + 1u) + s.stride_y * (cell.y / 2u) + cell.x / 8u];
    x[q] += select(above.xxyy, above.zzww, (cell.x & 4u) != 0u);
}
