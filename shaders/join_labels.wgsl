// liquid_components: joins the trees across the faces that the first labels left out (see join). Most such faces close a
// square of which the other three faces join liquid too, and join nothing new (as components_merge).
// One thread per quad of the band.
// level. band_args, band_list: the band. liquid_distance: m. open: face apertures. labels: in place.
#import dispatch
#import join
#import layout
#import liquid_lanes

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> liquid_distance: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> open: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> labels: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn join_labels(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let cell = quad_cell(level, quad);
    let x = joined(0u, quad, cell);
    let y = joined(1u, quad, cell);
    let z = joined(2u, quad, cell);
    // The first labels have one of them.
    if !any((x & y) | (x & z) | (y & z)) {
        return;
    }
    let sy = level.stride_y;
    let sz = level.stride_z;
    let cell_y = cell - vec3<i32>(0, 1, 0);
    let cell_z = cell - vec3<i32>(0, 0, 1);
    let cell_x = cell - vec3<i32>(4, 0, 0);
    let left_y = vec4<bool>(joined(1u, quad - 1u, cell_x).w, y.xyz);
    let left_z = vec4<bool>(joined(2u, quad - 1u, cell_x).w, z.xyz);
    let known_y = joined(2u, quad - sy, cell_y) & joined(1u, quad - sz, cell_z);
    let known_x = (z & left_z & joined(0u, quad - sz, cell_z)) | (y & left_y & joined(0u, quad - sy, cell_y));
    let join_y = y & z & !known_y;
    let join_x = x & (y | z) & !known_x;
    for (var l = 0u; l < 4u; l++) {
        let here = 4u * quad + l;
        if join_y[l] {
            join(here, here - 4u * sy);
        }
        if join_x[l] {
            join(here, here - 1u);
        }
    }
}
