// occupancy, first of two: adds round(2^20 w) of each marker to the 8 cells around it, w the product of the tents
// 1 - |d| along the axes. Cells beyond a wall are those at the wall. Spray and deleted markers are skipped.
// Integer sums do not depend on their order. A sum holds 4095 markers at the centre of one cell.
// One thread per used slot.
// level, step. markers: x, y, z (m), w = 1 alive, 0 deleted. marker_velocity: w = 1 for spray. marker_weights: in
// units of 2^-20, in place.
#import dispatch
#import layout
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> markers: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> marker_velocity: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> marker_weights: array<atomic<u32>>;

// Fixed point of the weights, also in occupancy_of_cells.wgsl.
const ONE = 1048576.0;

@compute @workgroup_size(WG_SIZE)
fn weigh_markers(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= step.n_markers {
        return;
    }
    let marker = markers[index];
    if marker.w == 0.0 || marker_velocity[index].w != 0.0 {
        return;
    }
    let at = marker.xyz * step.inv_dx - 0.5;
    let low = floor(at);
    let upper = at - low;
    let top = vec3<f32>(level.cells) - 1.0;
    let first = vec3<u32>(clamp(low, vec3<f32>(), top));
    let second = vec3<u32>(clamp(low + 1.0, vec3<f32>(), top));
    for (var corner = 0u; corner < 8u; corner++) {
        let up = (vec3<u32>(corner) >> vec3<u32>(0u, 1u, 2u) & vec3<u32>(1u)) != vec3<u32>();
        let weights = select(1.0 - upper, upper, up);
        let at_corner = select(first, second, up);
        let cell = cell_index(level, at_corner);
        atomicAdd(&marker_weights[cell], u32(round(ONE * (weights.x * weights.y * weights.z))));
    }
}
