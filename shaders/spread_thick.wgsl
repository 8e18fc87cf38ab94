// bound_level, second of five: marks cells with a mark within three along y. One thread per quad of the band.
// level. band_args, band_list, band_flags: the band. thick_in, thick_out: per quad the lanes.
#import dispatch
#import layout
#import thick

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> band_flags: array<u32>;
@group(0) @binding(4) var<storage, read> thick_in: array<u32>;
@group(0) @binding(5) var<storage, read_write> thick_out: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn spread_thick(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    thick_out[quad] = thick_along(quad, quad_cell(level, quad).y, i32(level.cells.y), level.stride_y);
}
