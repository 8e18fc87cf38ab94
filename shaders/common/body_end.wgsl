#import pair
#import real
#import solid_step

// Position of a ballistic node after the sub-step, m. The importing kernel declares step, rest, displacement and velocity.
fn end_of(node: u32) -> vec3<f32> {
    let u = pair_value(Pair(displacement[node].xyz, displacement[step.n_nodes + node].xyz));
    let way = step.dt * (vec3<f32>(velocity[node].xyz) + (0.5 * step.dt) * step.gravity);
    return rest[node].xyz + vec3<f32>(u) + way;
}
