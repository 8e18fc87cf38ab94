// Liquid that touches no wall, solid or source falls freely: it moves by g dt^2 / 2 beyond the way of its velocity (see
// reference/ballistic.rs).
// The importing kernel declares level, step and flags (per quad: see active), of the last solve.
#import active
#import layout
#import step

// g dt^2 / 2, cells.
fn fall() -> vec3<f32> {
    return (0.5 * step.dt * step.dt * step.inv_dx) * step.gravity;
}

// 0: no liquid, 1: ballistic, 2: neither.
fn kind_of(cell: vec3<i32>) -> u32 {
    let at = vec3<u32>(clamp(cell, vec3<i32>(), vec3<i32>(level.cells) - 1));
    let bits = flags[level.stride_z * (at.z + 1u) + level.stride_y * at.y + at.x / 4u] >> (at.x % 4u);
    let falls = bits >> BALLISTIC & 1u;
    return falls | (bits >> FILLED & ~falls & 1u) << 1u;
}

// Whether the filled cells with centres around a position (cells) are all ballistic, and there are any.
fn is_ballistic(at: vec3<f32>) -> bool {
    // Most liquid is neither: its own cell says so. A fixed surface stays.
    if step.n_markers == 0u || kind_of(vec3<i32>(floor(at))) == 2u {
        return false;
    }
    let low = vec3<i32>(floor(at - 0.5));
    var found = 0u;
    for (var corner = 0; corner < 8; corner++) {
        found |= kind_of(low + (vec3<i32>(corner) >> vec3<u32>(0u, 1u, 2u) & vec3<i32>(1)));
    }
    return found == 1u;
}

// Distance from a plane of cell centres below which a position has the cells of both sides around it, cells.
const BESIDE_PLANE = 1e-3;

// The same for positions that may be on planes of cell centres, where rounding must not decide: the cells on both sides
// of such a plane count.
fn is_ballistic_about(at: vec3<f32>) -> bool {
    if step.n_markers == 0u || kind_of(vec3<i32>(floor(at))) == 2u {
        return false;
    }
    let low = vec3<i32>(floor(at - (0.5 + BESIDE_PLANE)));
    let high = vec3<i32>(floor(at - (0.5 - BESIDE_PLANE))) + 1;
    var found = 0u;
    for (var z = low.z; z <= high.z; z++) {
        for (var y = low.y; y <= high.y; y++) {
            for (var x = low.x; x <= high.x; x++) {
                found |= kind_of(vec3<i32>(x, y, z));
            }
        }
    }
    return found == 1u;
}
