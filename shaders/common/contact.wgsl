#import freedom

// What walls and obstacles hold: twin of reference/solid_contacts.rs, where the rules stand.
// gaps: per node the distances from the nearer walls across x, y, z, m, with its flags (see node_flags) and, eight times, bits of the
// axes of which that wall is the lower one; with obstacles a second section, unit normal or 0 and distance, m.

// A node this near, in cells, is held from the start if it is pressed to the surface.
const SKIN = 1e-3;
// How far from where it should be, in cells, a node is left.
const NEAR = 1e-4;
// An obstacle does not hold a node whose free components are further from its normal.
const LEAST_SHARE = 0.1;

// How often a node is put back before one surface after the other.
const SWEEPS = 4;

// 1 where the nearer wall is the lower one, else -1: the normals away from it.
fn outwards(walls: vec4<f32>) -> Real3 {
    return select(Real3(Real(-1.0)), Real3(Real(1.0)), is_free(u32(walls.w) / 8u));
}

// Components that a wall holds.
fn held_by_walls(walls: vec4<f32>, freedom: vec4<f32>) -> vec3<bool> {
    return is_free(u32(walls.w)) & !free_components(freedom);
}

fn held_by_obstacle(freedom: vec4<f32>) -> bool {
    return any(freedom.xyz != vec3<f32>());
}

// Distances from the walls after a sub-step of dt (s) with the velocity v (m/s).
fn wall_gaps(walls: vec4<f32>, v: Real3, dt: Real) -> Real3 {
    return Real3(walls.xyz) + dt * outwards(walls) * v;
}

fn flags_of(components: vec3<bool>) -> u32 {
    return dot(vec3<u32>(components), vec3<u32>(1u, 2u, 4u));
}

// The direction nearest to an obstacle's normal among the components without a script; 0 where they share little of it.
fn shared_direction(walls: vec4<f32>, normal: vec3<f32>) -> Real3 {
    let flags = flags_of(is_free(u32(walls.w)));
    return Real3(held_along(vec4<f32>(vec3<f32>(), f32(flags)), normal).xyz);
}

// The velocity v, m/s, before the walls: a component that would take the node beyond one in a sub-step of dt (s) takes it there.
fn before_walls(walls: vec4<f32>, v: Real3, dt: Real) -> Real3 {
    let passed = is_free(u32(walls.w)) & (wall_gaps(walls, v, dt) < Real3());
    return select(v, -outwards(walls) * Real3(walls.xyz) / dt, passed);
}

// The same before an obstacle, along the direction that it shares; surface: normal, gap.
fn before_obstacle(walls: vec4<f32>, surface: vec4<f32>, v: Real3, dt: Real) -> Real3 {
    let n = Real3(surface.xyz);
    let gap = Real(surface.w);
    let direction = shared_direction(walls, surface.xyz);
    if all(direction == Real3()) || gap + dt * dot(v, n) >= Real() {
        return v;
    }
    return v + direction * ((-gap / dt - dot(v, n)) / dot(direction, n));
}

// The freedom of a node that only walls hold, as far as its free components share the normal held along it too.
fn held_along(walls_only: vec4<f32>, normal: vec3<f32>) -> vec4<f32> {
    let kept = select(vec3<f32>(), normal, free_components(walls_only));
    let share = length(kept);
    if share < LEAST_SHARE {
        return walls_only;
    }
    return vec4<f32>(kept / share, walls_only.w);
}
