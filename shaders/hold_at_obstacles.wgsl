// move_solid, before the motion, with obstacles: bodies that touch one at the end of it are not ballistic. One workgroup per
// body.
// level, step. free_bodies: see ballistic_body. rest: m. displacement: larger parts, then smaller, m. velocity: m/s.
// distances: to obstacles, cell centres, m. ballistic: per node, 0 or 1; in place.
#import ballistic_body
#import body_end
#import layout
#import pair
#import real
#import sample_distance
#import solid_step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: SolidStep;
@group(0) @binding(2) var<storage, read> free_bodies: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> rest: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> displacement: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> velocity: array<Real4>;
@group(0) @binding(6) var<storage, read> distances: array<f32>;
@group(0) @binding(7) var<storage, read_write> ballistic: array<u32>;

fn touches(node: u32) -> bool {
    return sample_distance(end_of(node) * step.inv_dx).x <= 0.0;
}

@compute @workgroup_size(FOLD_SIZE)
fn hold_at_obstacles(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let nodes = nodes_of(group_index(workgroup));
    if body_touches(nodes, lane) {
        mark(nodes, lane, 0u);
    }
}
