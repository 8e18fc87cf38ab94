// extrapolate with solids: free slip along obstacles and solids, relative to their velocity (see slide). One thread
// per quad of the band.
// level, step. band_args, band_list: the band. solid_distance: cell centres, m. velocity: faces, m/s. valid: open
// faces. velocity_next: new velocities of slipping faces, m/s. slipping: those faces, bit 4 axis + lane. walls: see
// moving_walls. clipped: index of the first velocity.
#import cut_quad
#import dispatch
#import layout
#import moving_walls
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
@group(0) @binding(9) var<uniform> clipped: Clipped;
@group(0) @binding(10) var<storage, read> walls: array<u32>;

// Mean over the two cells of a face that have a closest point.
fn wall_velocity(axis: u32, cell: vec3<i32>) -> vec3<f32> {
    var sum = vec3<f32>();
    var n = 0.0;
    for (var side = 0; side < 2; side++) {
        let c = vec3<u32>(cell - side * along(axis));
        let word = walls[cell_index(level, c) / 4u];
        if has_place(word, c.x % 4u) {
            let at = clipped.first + 3u * place_of(word, c.x % 4u);
            sum += bitcast<vec3<f32>>(vec3<u32>(walls[at], walls[at + 1u], walls[at + 2u]));
            n += 1.0;
        }
    }
    return sum / max(n, 1.0);
}

@compute @workgroup_size(WG_SIZE)
fn slip_along_solids(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index < band_args[3] {
        slip_quad(band_list[index]);
    }
}
