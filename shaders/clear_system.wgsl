// Stage active_cells, first: clears the flags and the matrix of a level over the active quads of the last sub-step.
// Both are zero in all other quads.
// level: the level. list, args: its active quads in the last sub-step. flags: per quad. matrix: see level.
#import dispatch
#import level
#import real

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> args: array<u32>;
@group(0) @binding(3) var<storage, read_write> flags: array<u32>;
@group(0) @binding(4) var<storage, read_write> matrix: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn clear_system(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= args[level.args + 3u] {
        return;
    }
    let q = list[level.shape.first + ix] & ~UNIFORM;
    flags[q] = 0u;
    for (var section = 0u; section <= INV_DIAGONAL; section++) {
        matrix[section * level.shape.total + q] = Real4();
    }
}
