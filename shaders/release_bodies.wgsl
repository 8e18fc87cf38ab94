// move_solid, before the motion: bodies that touch no wall of the domain at the end of it are ballistic (twin:
// reference/ballistic.rs). One workgroup per body.
// step. free_bodies: see ballistic_body. rest: m. displacement: larger parts, then smaller, m. velocity: m/s. ballistic: per
// node, 0 or 1; out.
#import ballistic_body
#import body_end
#import pair
#import real
#import solid_step

@group(0) @binding(0) var<uniform> step: SolidStep;
@group(0) @binding(1) var<storage, read> free_bodies: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> rest: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> displacement: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> velocity: array<Real4>;
@group(0) @binding(5) var<storage, read_write> ballistic: array<u32>;

fn touches(node: u32) -> bool {
    let end = end_of(node);
    return any(end <= vec3<f32>()) || any(end >= step.size);
}

@compute @workgroup_size(FOLD_SIZE)
fn release_bodies(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let nodes = nodes_of(group_index(workgroup));
    let touched = body_touches(nodes, lane);
    mark(nodes, lane, select(1u, 0u, touched));
}
