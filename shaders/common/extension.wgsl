// Extension of a distance or a level into cells without one, as a mean over known neighbours weighted by face apertures
// (equation in the twin, reference/liquid_distance.rs).
// A neighbour contributes its value minus the slope times the offset. The slope along an axis is a mean over pairs of
// a neighbour and a known cell behind it, and FLAT_PAIRS pairs of slope 0. The weight of a pair is the product of both
// apertures. The result is limited to the range of the neighbours' values, up to OVERSHOOT beyond it.
// On demand neighbours across closed faces contribute too, all with weight 1.
// Cells outside the band are unknown.
// The importing kernel declares FLAT_PAIRS, OVERSHOOT, level: Layout, step: Step, band_flags: array<u32>, open:
// array<f32> (apertures of the minus faces) and distance_in: array<f32>.
#import layout
#import step
#import unknown

// The neighbour across a face of a cell.
struct Neighbour {
    cell: u32,
    // Aperture, 0 for an unknown neighbour.
    open: f32,
    phi: f32,
}

// Whether the index is outside the domain.
fn outside(cell: u32) -> bool {
    let at = quad_cell(level, cell / 4u) + vec3<i32>(i32(cell % 4u), 0, 0);
    return any(at < vec3<i32>()) || any(at >= vec3<i32>(level.cells));
}

// Neighbour on a side (0 minus, 1 plus) along an axis. closed: closed faces count as open, and all with aperture 1.
fn neighbour(cell: u32, axis: u32, side: u32, closed: bool) -> Neighbour {
    let stride = select(select(4u * level.stride_z, 4u * level.stride_y, axis == 1u), 1u, axis == 0u);
    let plus = cell + side * stride;
    let fraction = select(open[axis * 4u * level.quads + plus], 1.0, closed);
    if fraction == 0.0 {
        return Neighbour();
    }
    let other = plus - (1u - side) * stride;
    let phi = distance_in[other];
    let inside = (!closed && step.open_sides == 0u) || !outside(other);
    let known = band_flags[other / 4u] != 0u && phi < UNKNOWN && inside;
    return Neighbour(other, select(0.0, fraction, known), phi);
}

fn from_neighbours(cell: u32, closed: bool) -> f32 {
    var slope = vec3<f32>();
    var pairs = vec3<f32>(FLAT_PAIRS);
    for (var face = 0u; face < 6u; face++) {
        let n = neighbour(cell, face / 2u, face % 2u, closed);
        if n.open == 0.0 {
            continue;
        }
        for (var next = 0u; next < 6u; next++) {
            let m = neighbour(n.cell, next / 2u, next % 2u, false);
            if m.open > 0.0 {
                let weight = n.open * m.open;
                slope[next / 2u] += weight * select(n.phi - m.phi, m.phi - n.phi, next % 2u == 1u);
                pairs[next / 2u] += weight;
            }
        }
    }
    // Without pairs along an axis there is no slope.
    slope /= select(pairs, vec3<f32>(1.0), pairs == vec3<f32>());
    var sum = 0.0;
    var weights = 0.0;
    var low = UNKNOWN;
    var high = -UNKNOWN;
    for (var face = 0u; face < 6u; face++) {
        let n = neighbour(cell, face / 2u, face % 2u, closed);
        if n.open > 0.0 {
            let rise = slope[face / 2u];
            sum += n.open * (n.phi - select(-rise, rise, face % 2u == 1u));
            weights += n.open;
            low = min(low, n.phi);
            high = max(high, n.phi);
        }
    }
    if weights == 0.0 {
        return UNKNOWN;
    }
    return clamp(sum / weights, low - OVERSHOOT, high + OVERSHOOT);
}
