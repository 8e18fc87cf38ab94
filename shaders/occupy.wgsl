// band, first of three: marks cells and tiles with markers. One thread per marker.
// level, step, tiles. markers: x, y, z (m), w = 1 alive. occupied: see classes. marks: per tile, 0 or 1.
#import dispatch
#import layout
#import step
#import tiles
#import classes

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<uniform> tiles: Tiles;
@group(0) @binding(3) var<storage, read> markers: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> occupied: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read_write> marks: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn occupy(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= step.n_markers {
        return;
    }
    let marker = markers[index];
    if marker.w == 0.0 {
        return;
    }
    let cell = cell_of(level, marker.xyz * step.inv_dx);
    let quad = cell_index(level, cell) / 4u;
    let bit = 1u << (MARKED + cell.x % 4u);
    if (atomicLoad(&occupied[quad]) & bit) == 0u {
        atomicOr(&occupied[quad], bit);
        atomicStore(&marks[tile_index(tiles, cell / TILE)], 1u);
    }
}
