// Blended velocity of small-aperture faces for extrapolate and advect_velocity (reason in reference/slivers.rs), u +
// (1 - a / SLIVER) trust(W) (m - u), m = sum_n w_n u_n / W, W = sum_n w_n, with aperture a and n the 26 neighbours of
// the same axis.
// The importing kernel declares level, open, velocity, weight(axis, face): w of a face by its index, and trust(sum):
// t of the sum of weights.
#import face_index
#import lanes
#import layout
#import valid

// Blended velocity of a small-aperture face of a quad, bit 4 axis + lane, m/s. Its own velocity if no neighbour has a
// weight.
fn shown(quad: u32, bit: u32) -> f32 {
    let axis = bit / 4u;
    let cell = quad_cell(level, quad) + vec3<i32>(i32(bit % 4u), 0, 0);
    let face = face_index(axis, cell);
    let extents = face_extents(level, axis);
    var sum = 0.0;
    var weights = 0.0;
    for (var number = 0; number < 27; number++) {
        let at = cell + vec3<i32>(number % 3, number / 3 % 3, number / 9) - 1;
        if number == 13 || any(at < vec3<i32>()) || any(at >= extents) {
            continue;
        }
        let neighbour = face_index(axis, at);
        let w = weight(axis, neighbour);
        if w > 0.0 {
            sum += w * velocity[neighbour];
            weights += w;
        }
    }
    let own = velocity[face];
    if weights == 0.0 {
        return own;
    }
    return own + (1.0 - open[face] / SLIVER) * trust(weights) * (sum / weights - own);
}
