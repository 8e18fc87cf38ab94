// band with a level, second: marks the tiles with markers of the liquid. Spray needs no band: it has its own velocity, and no part in the level.
// One thread per used slot.
// level, step, tiles. markers: x, y, z (m), w = 1 alive. marker_velocity: m/s, w = 1 for spray. marks: per tile, 0 or 1.
#import dispatch
#import layout
#import step
#import tiles

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<uniform> tiles: Tiles;
@group(0) @binding(3) var<storage, read> markers: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> marker_velocity: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> marks: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn mark_markers(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= step.n_markers {
        return;
    }
    let marker = markers[index];
    if marker.w == 0.0 || marker_velocity[index].w == 1.0 {
        return;
    }
    let tile = tile_index(tiles, cell_of(level, marker.xyz * step.inv_dx) / TILE);
    if atomicLoad(&marks[tile]) == 0u {
        atomicStore(&marks[tile], 1u);
    }
}
