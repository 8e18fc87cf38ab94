#import freedom

// Contact of nodes with walls and obstacles; algorithm in reference/solid_contacts.rs.
// gaps: per node the distances from the nearer walls across x, y, z, m, then its flags (see node_flags) plus eight
// times the bits of the axes whose lower wall is nearer. With obstacles a second section: unit normal or 0, and
// distance, m, after the next move for a node at rest. With moving ones a third: their velocity along the normal, m/s.

// Gap below which a node is initially constrained if it is pressed to the surface, and largest penetration in a longer sub-step, cells.
const SKIN = 1e-3;
// Tolerance of gaps and contact, cells.
const NEAR = 1e-4;
// Smallest cosine between an obstacle's normal and the node's free components for a constraint.
const LEAST_SHARE = 0.1;

// Sweeps over the surfaces of a node in the projection to feasibility.
const SWEEPS = 4;

// Outward normals: 1 for the lower wall, -1 for the upper one.
fn outwards(walls: vec4<f32>) -> Real3 {
    return select(Real3(Real(-1.0)), Real3(Real(1.0)), is_free(u32(walls.w) / 8u));
}

// Components that a wall constrains.
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

// The direction closest to an obstacle's normal in components that are not prescribed; 0 if their common part is
// small.
fn shared_direction(walls: vec4<f32>, normal: vec3<f32>) -> Real3 {
    let flags = flags_of(is_free(u32(walls.w)));
    return Real3(held_along(vec4<f32>(vec3<f32>(), f32(flags)), normal).xyz);
}

// The velocity v, m/s, limited per component so that the node at most reaches a wall in a sub-step of dt (s).
fn before_walls(walls: vec4<f32>, v: Real3, dt: Real) -> Real3 {
    let passed = is_free(u32(walls.w)) & (wall_gaps(walls, v, dt) < Real3());
    return select(v, -outwards(walls) * Real3(walls.xyz) / dt, passed);
}

// The same for an obstacle, along the shared direction; surface: normal, gap.
fn before_obstacle(walls: vec4<f32>, surface: vec4<f32>, v: Real3, dt: Real) -> Real3 {
    let n = Real3(surface.xyz);
    let gap = Real(surface.w);
    let direction = shared_direction(walls, surface.xyz);
    if all(direction == Real3()) || gap + dt * dot(v, n) >= Real() {
        return v;
    }
    return v + direction * ((-gap / dt - dot(v, n)) / dot(direction, n));
}

// The rate at which a node with the velocity v, m/s, closes its gap to a wall relative to that gap and the skin (m), 1/s.
fn closing_rate_of_walls(walls: vec4<f32>, v: Real3, skin: f32) -> f32 {
    let closing = max(vec3<f32>(-outwards(walls) * v), vec3<f32>());
    let rates = select(vec3<f32>(), closing / (max(walls.xyz, vec3<f32>()) + skin), is_free(u32(walls.w)));
    return max(max(rates.x, rates.y), rates.z);
}

// The same for an obstacle; surface: normal, gap after a move by dt (s) for a node at rest. rate: of the obstacle, m/s.
fn closing_rate_of_obstacle(walls: vec4<f32>, surface: vec4<f32>, rate: f32, v: Real3, dt: f32, skin: f32) -> f32 {
    if all(shared_direction(walls, surface.xyz) == Real3()) {
        return 0.0;
    }
    let closing = rate - f32(dot(v, Real3(surface.xyz)));
    return max(closing, 0.0) / (max(surface.w + dt * rate, 0.0) + skin);
}

// Adds the constraint along an obstacle's normal to a node constrained by walls only, in its free components.
fn held_along(walls_only: vec4<f32>, normal: vec3<f32>) -> vec4<f32> {
    let kept = select(vec3<f32>(), normal, free_components(walls_only));
    let share = length(kept);
    if share < LEAST_SHARE {
        return walls_only;
    }
    return vec4<f32>(kept / share, walls_only.w);
}
