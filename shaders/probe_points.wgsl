// probe, at points. Height: last sign change, going up, of the liquid distance interpolated to a line along an axis.
// Pressure: between cell centres, 0 in air, without inactive cells of liquid (inside obstacles). Velocity: between
// faces.
// One thread per probe.
// level, step. points: see probe_point. liquid_distance: m. flags: see active. potential: m/s. velocity: faces, m/s.
// values: m, Pa or m/s along x, y, z, four words per probe, after those of the fronts.
#import corner
#import dispatch
#import layout
#import step
#import sample_velocity
#import ghost_fluid
#import probe_point
#import real

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> points: array<ProbePoint>;
@group(0) @binding(3) var<storage, read> liquid_distance: array<f32>;
@group(0) @binding(4) var<storage, read> flags: array<u32>;
@group(0) @binding(5) var<storage, read> potential: array<Real>;
@group(0) @binding(6) var<storage, read> velocity: array<f32>;
@group(0) @binding(7) var<storage, read_write> values: array<vec4<f32>>;

// Index and weight of one of the eight cells.
fn corner_cell(corner: Corner, c: u32) -> u32 {
    return corner.low + (c & 1u) + 4u * (level.stride_y * (c >> 1u & 1u) + level.stride_z * (c >> 2u));
}
fn corner_weight(corner: Corner, c: u32) -> f32 {
    let upper = (vec3<u32>(c) >> vec3<u32>(0u, 1u, 2u) & vec3<u32>(1u)) == vec3<u32>(1u);
    let w = select(1.0 - corner.f, corner.f, upper);
    return w.x * w.y * w.z;
}

// Liquid distance on the line through at along an axis, at the centres of row j, m.
fn distance_in_row(at: vec3<f32>, axis: u32, j: u32) -> f32 {
    var centre = at;
    centre[axis] = f32(j) + 0.5;
    let corner = centres_around(centre);
    var sum = 0.0;
    for (var c = 0u; c < 8u; c++) {
        let weight = corner_weight(corner, c);
        if weight > 0.0 {
            sum += weight * liquid_distance[corner_cell(corner, c)];
        }
    }
    return sum;
}

// Height, m; kind: see probe_point.
fn height(at: vec3<f32>, kind: u32) -> f32 {
    let axis = kind >> 2u & 3u;
    let n = level.cells[axis];
    var above = 0.0;
    for (var j = n; j > 0u; j--) {
        let phi = distance_in_row(at, axis, select(j - 1u, n - j, (kind >> 4u & 1u) == 1u));
        if phi < 0.0 {
            let rise = select(ghost_theta(phi, above, 0.0), 0.5, j == n);
            return (f32(j) - 0.5 + rise) * step.dx;
        }
        above = phi;
    }
    return 0.0;
}

// Pressure, Pa.
fn pressure(at: vec3<f32>) -> f32 {
    if step.dt <= 0.0 {
        return 0.0;
    }
    let corner = centres_around(at);
    var sum = Real();
    var weights = Real();
    for (var c = 0u; c < 8u; c++) {
        let cell = corner_cell(corner, c);
        let weight = corner_weight(corner, c);
        let is_active = (flags[cell / 4u] >> (cell % 4u) & 1u) != 0u;
        if weight > 0.0 && (is_active || liquid_distance[cell] >= 0.0) {
            weights += Real(weight);
            if is_active {
                sum += Real(weight) * potential[cell];
            }
        }
    }
    if weights <= Real() {
        return 0.0;
    }
    return f32(sum / weights) * (step.density * step.dx / step.dt);
}

@compute @workgroup_size(WG_SIZE)
fn probe_points(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= arrayLength(&points) {
        return;
    }
    let probe = points[index];
    let at = probe.point * step.inv_dx;
    var value = vec3<f32>();
    switch probe.kind & 3u {
        case HEIGHT: { value.x = height(at, probe.kind); }
        case PRESSURE: { value.x = pressure(at); }
        default: { value = sample_velocity(at); }
    }
    values[index + 2u] = vec4<f32>(value, 0.0);
}
