// Liquid that touches no wall, solid or source falls freely: it moves by g dt^2 / 2 beyond the way of its velocity (see
// reference/ballistic.rs).
// The importing kernel declares level, step and flags (per quad: see active), of the last solve.
#import active
#import fall
#import layout
#import step

// Whether the filled cells with centres around a position (cells) are all ballistic, and there are any. Cells beyond a wall are those at the
// wall.
fn is_ballistic(at: vec3<f32>) -> bool {
    let top = vec3<i32>(level.cells) - 1;
    let low = vec3<i32>(floor(at - 0.5));
    let a = vec3<u32>(clamp(low, vec3<i32>(), top));
    let b = vec3<u32>(clamp(low + 1, vec3<i32>(), top));
    let y = level.stride_y * vec2<u32>(a.y, b.y);
    let z = level.stride_z * (vec2<u32>(a.z, b.z) + 1u);
    let rows = vec4<u32>(y + z.x, y + z.y);
    let near = rows + a.x / 4u;
    let far = rows + b.x / 4u;
    let minus = vec4<u32>(flags[near.x], flags[near.y], flags[near.z], flags[near.w]) >> vec4<u32>(a.x % 4u);
    let plus = vec4<u32>(flags[far.x], flags[far.y], flags[far.z], flags[far.w]) >> vec4<u32>(b.x % 4u);
    let falls = (minus | plus) >> vec4<u32>(BALLISTIC);
    let rests = resting(minus) | resting(plus);
    // A fixed surface stays.
    return step.n_markers != 0u && any((falls & vec4<u32>(1u)) != vec4<u32>()) && all((rests & vec4<u32>(1u)) == vec4<u32>());
}

// Filled lanes that are not ballistic, from bit 0 on.
fn resting(words: vec4<u32>) -> vec4<u32> {
    return words >> vec4<u32>(FILLED) & ~(words >> vec4<u32>(BALLISTIC)) & vec4<u32>(15u);
}

// Distance from a plane of cell centres below which a position has the cells of both sides around it, cells.
const BESIDE_PLANE = 1e-3;

// The same for positions that may be on planes of cell centres, where rounding must not decide: the cells on both sides
// of such a plane count.
fn is_ballistic_about(at: vec3<f32>) -> bool {
    let top = vec3<i32>(level.cells) - 1;
    let low = vec3<u32>(clamp(vec3<i32>(floor(at - (0.5 + BESIDE_PLANE))), vec3<i32>(), top));
    let high = vec3<u32>(clamp(vec3<i32>(floor(at - (0.5 - BESIDE_PLANE))) + 1, vec3<i32>(), top));
    var falls = vec2<u32>();
    var rests = vec2<u32>();
    for (var z = low.z; z <= high.z; z++) {
        for (var y = low.y; y <= high.y; y++) {
            let row = level.stride_z * (z + 1u) + level.stride_y * y;
            let words = vec2<u32>(flags[row + low.x / 4u], flags[row + high.x / 4u]);
            falls |= words >> vec2<u32>(BALLISTIC);
            rests |= resting(words.xyxy).xy;
        }
    }
    // The two or three lanes from the first on, in two quads.
    let lanes = ((2u << (high.x - low.x)) - 1u) << (low.x % 4u);
    let found = vec2<u32>(falls.x & 15u | (falls.y & 15u) << 4u, rests.x | rests.y << 4u) & vec2<u32>(lanes);
    return step.n_markers != 0u && found.x != 0u && found.y == 0u;
}
