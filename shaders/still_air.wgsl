// write_back, first: sets velocities to zero in tiles that have left the band. One thread per tile; few tiles leave
// per sub-step.
// level, tiles. dilated: see tiles; in place. velocity: faces, m/s.
#import dispatch
#import layout
#import tiles

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> tiles: Tiles;
@group(0) @binding(2) var<storage, read_write> dilated: array<u32>;
@group(0) @binding(3) var<storage, read_write> velocity: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn still_air(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= tiles.n.x * tiles.n.y * tiles.n.z || dilated[index] != BEFORE {
        return;
    }
    dilated[index] = 0u;
    let low = TILE * tile_at(tiles, index);
    let end = min(low + TILE, level.cells + 1u);
    for (var z = low.z; z < end.z; z++) {
        for (var y = low.y; y < end.y; y++) {
            let quad = level.stride_z * (z + 1u) + level.stride_y * y + low.x / 4u;
            for (var axis = 0u; axis < 3u; axis++) {
                velocity[axis * level.quads + quad] = vec4<f32>();
                velocity[axis * level.quads + quad + 1u] = vec4<f32>();
            }
        }
    }
}
