// extrapolate with obstacles: free slip along them (see slide). One thread per quad of the band.
// level, step. band_args, band_list: the band. solid_distance: cell centres, m. velocity: faces, m/s. valid: open
// faces. velocity_next: new velocities of slipping faces, m/s. slipping: those faces, bit 4 axis + lane.
#import dispatch
#import layout
#import slide
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> solid_distance: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> velocity: array<f32>;
@group(0) @binding(6) var<storage, read> valid: array<u32>;
@group(0) @binding(7) var<storage, read_write> velocity_next: array<f32>;
@group(0) @binding(8) var<storage, read_write> slipping: array<u32>;

// Static obstacles.
fn wall_velocity(axis: u32, cell: vec3<i32>) -> vec3<f32> {
    return vec3<f32>();
}

@compute @workgroup_size(WG_SIZE)
fn slip(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index < band_args[3] {
        slip_quad(band_list[index]);
    }
}
