// Free slip along solids: closed faces in and just outside them, except domain walls, lose the normal part of their
// velocity relative to the wall: u_a - ((v - w) . n) n_a. n is the direction of the interpolated distance by central
// differences over dx. With separation faces between cells of air and separated ones keep a velocity away from the wall.
// The importing kernel declares level, step, solid_distance (vec4 per quad), velocity, valid, velocity_next, slipping
// (see slip), and wall_velocity(axis, cell): w at the minus face of a cell, m/s.
#import face_index
#import layout
#import lanes
#import step
#import valid

// Distance from a surface below which faces slip along it, cells.
const SLIP_REACH = 0.5;
// Distance of a cell beyond which none of its faces slips, as the distance changes by at most one cell per cell.
const FAR = 2.0;
// Gradient (dimensionless) below which there is no direction.
const SMALLEST_GRADIENT = 1e-6;

// Distance at a cell, clamped to the domain, m.
fn distance_of(cell: vec3<i32>) -> f32 {
    let c = vec3<u32>(clamp(cell, vec3<i32>(), vec3<i32>(level.cells) - 1));
    return solid_distance[cell_index(level, c) / 4u][c.x % 4u];
}

// New velocity of a face between two cells.
fn slide(axis: u32, cell: vec3<i32>) -> f32 {
    let minus = cell - along(axis);
    var v = vec3<f32>();
    for (var b = 0u; b < 3u; b++) {
        v[b] = velocity[face_index(b, cell)];
        if b != axis {
            v[b] = 0.25 * ((v[b] + velocity[face_index(b, cell + along(b))])
                + (velocity[face_index(b, minus)] + velocity[face_index(b, minus + along(b))]));
        }
    }
    // The velocity is relative to the wall; without a wall velocity deep inside a solid.
    let relative = v - wall_velocity(axis, cell);
    if all(relative == vec3<f32>()) {
        return v[axis];
    }
    var gradient = vec3<f32>();
    for (var b = 0u; b < 3u; b++) {
        if b == axis {
            gradient[b] = distance_of(cell) - distance_of(minus);
        } else {
            gradient[b] = 0.25 * ((distance_of(cell + along(b)) - distance_of(cell - along(b)))
                + (distance_of(minus + along(b)) - distance_of(minus - along(b))));
        }
    }
    let steepness = length(gradient);
    if steepness < SMALLEST_GRADIENT * step.dx {
        return v[axis];
    }
    let n = gradient / steepness;
    var away = dot(relative, n);
    if leaves(cell) && leaves(minus) {
        away = min(away, 0.0);
    }
    return v[axis] - away * n[axis];
}

// Whether liquid may leave walls and bodies in a cell.
fn leaves(cell: vec3<i32>) -> bool {
    let c = vec3<u32>(cell);
    let quad = cell_index(level, c) / 4u;
    return (valid[quad] >> (LEAVING_FIRST + c.x % 4u) & 1u) == 1u;
}

// Lanes whose face has a cell on both sides and is near a surface.
fn near_lanes(here: vec4<f32>, minus: vec4<f32>, cell: vec3<i32>, axis: u32) -> u32 {
    let n = vec3<i32>(level.cells);
    let near = 0.5 * (here + minus) < vec4<f32>(SLIP_REACH * step.dx);
    return lane_bits(near & lanes_inside(cell, n) & lanes_inside(cell - along(axis), n));
}

// Computes the slipping faces of a quad, and their new velocities.
fn slip_quad(quad: u32) {
    let cell = quad_cell(level, quad);
    let word = valid[quad];
    let here = solid_distance[quad];
    // At this distance no face between this quad and its neighbours is near a surface.
    if all(here >= vec4<f32>(FAR * step.dx)) {
        slipping[quad] = word & ~VALID;
        return;
    }
    // Closed faces with a cell on both sides near a surface.
    var found = near_lanes(here, shift_up(solid_distance[quad - 1u], here), cell, 0u)
        | near_lanes(here, solid_distance[quad - level.stride_y], cell, 1u) << 4u
        | near_lanes(here, solid_distance[quad - level.stride_z], cell, 2u) << 8u;
    found &= ~(word >> OPEN);
    slipping[quad] = (word & ~VALID) | found;
    while found != 0u {
        let bit = firstTrailingBit(found);
        found &= found - 1u;
        let axis = bit / 4u;
        let at = cell + vec3<i32>(i32(bit % 4u), 0, 0);
        velocity_next[face_index(axis, at)] = slide(axis, at);
    }
}
