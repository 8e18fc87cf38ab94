// The importing kernel declares level: Layout, flags (see active, without separated lanes), open: apertures for the pressure,
// array<f32>, potential and rhs, array<Real4>, m/s.
#import face_index
#import layout
#import real

// Potential of a cell beside another, m/s; 0 in air and in separated cells.
fn potential_of(cell: vec3<i32>) -> Real {
    let c = vec3<u32>(cell);
    let quad = cell_index(level, c) / 4u;
    let lane = c.x % 4u;
    return select(Real(0.0), potential[quad][lane], (flags[quad] >> lane & 1u) == 1u);
}

// Rate w = B p - b at which a separated cell opens, over dx^2, m/s.
fn opening(cell: vec3<i32>, b: Real) -> Real {
    var w = -b;
    for (var axis = 0u; axis < 3u; axis++) {
        let step = along(axis);
        if cell[axis] > 0 {
            let aperture = max(open[face_index(axis, cell)], 0.0);
            w -= Real(aperture) * potential_of(cell - step);
        }
        if cell[axis] + 1 < i32(level.cells[axis]) {
            let aperture = max(open[face_index(axis, cell + step)], 0.0);
            w -= Real(aperture) * potential_of(cell + step);
        }
    }
    return w;
}
