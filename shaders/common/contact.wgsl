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

// 1 where the nearer wall is the lower one, else -1: the normals away from it.
fn outwards(walls: vec4<f32>) -> Real3 {
    return select(Real3(Real(-1.0)), Real3(Real(1.0)), is_free(u32(walls.w) / 8u));
}

// Components that a wall holds.
fn held_by_walls(walls: vec4<f32>, freedom: vec4<f32>) -> vec3<bool> {
    return is_free(u32(walls.w)) & !free_components(freedom);
}

fn flags_of(components: vec3<bool>) -> u32 {
    return dot(vec3<u32>(components), vec3<u32>(1u, 2u, 4u));
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
