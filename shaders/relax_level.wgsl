// redistance, last: one relaxation step of the mixed level f (equations in the twin, reference/redistance.rs). Cells in
// bodies keep their level. One thread per quad of the band; outside it there is air.
// level. band_args, band_list, band_flags: the band. open, solid_distance: see level_cells. mixed: f, cells. new_level:
// cells, out.
#import dispatch
#import layout
#import lanes
#import level_cells

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> band_flags: array<u32>;
@group(0) @binding(4) var<storage, read> open: array<f32>;
@group(0) @binding(5) var<storage, read> solid_distance: array<f32>;
@group(0) @binding(6) var<storage, read> mixed: array<f32>;
@group(0) @binding(7) var<storage, read_write> new_level: array<f32>;

// The constants of reference/redistance.rs.
// Level within which it is relaxed, cells.
const NEAR = 2.5;
// Step of the relaxation, cells.
const STEP = 0.4;
// Gradients of interface cells that stay.
const LEAST_GRADIENT = 0.7;
const LARGEST_GRADIENT = 1.4;
// Steepness of both sides of a kink.
const KINK = 0.1;

fn value(cell: u32) -> f32 {
    if band_flags[cell / 4u] == 0u {
        return REACH;
    }
    return mixed[cell];
}

// Differences to the minus and to the plus side along each axis.
struct Slopes {
    low: vec3<f32>,
    high: vec3<f32>,
}

fn slopes(cell: u32) -> Slopes {
    let here = value(cell);
    var low: vec3<f32>;
    var high: vec3<f32>;
    for (var axis = 0u; axis < 3u; axis++) {
        low[axis] = here - value(across(cell, axis, 0u));
        high[axis] = value(across(cell, axis, 1u)) - here;
    }
    return Slopes(low, high);
}

fn is_kink(s: Slopes) -> bool {
    return any((s.low * s.high < vec3<f32>()) & (min(abs(s.low), abs(s.high)) > vec3<f32>(KINK)));
}

// |grad f|: the central slope along axes where both one-sided ones agree in sign, else the largest.
fn steepness(s: Slopes) -> f32 {
    let central = 0.5 * abs(s.low + s.high);
    let largest = max(max(abs(s.low), abs(s.high)), central);
    return length(select(largest, central, s.low * s.high > vec3<f32>()));
}

// The neighbours across the interface, a bit per face.
fn across_interface(cell: u32) -> u32 {
    let inside = value(cell) < 0.0;
    var bits = 0u;
    for (var face = 0u; face < 6u; face++) {
        let other = beside(cell, face / 2u, face % 2u);
        bits |= u32((value(other) < 0.0) != inside) << face;
    }
    return bits;
}

fn relaxed(cell: u32) -> f32 {
    let phi = mixed[cell];
    if abs(phi) >= NEAR {
        return phi;
    }
    let s = slopes(cell);
    var faces = across_interface(cell);
    if faces == 0u {
        let way = select(1.0, -1.0, phi < 0.0);
        let upwind = max(max(way * s.low, vec3<f32>()), -min(way * s.high, vec3<f32>()));
        return phi - STEP * way * (length(upwind) - 1.0);
    }
    let m = steepness(s);
    if (LEAST_GRADIENT < m && m < LARGEST_GRADIENT) || is_kink(s) {
        return phi;
    }
    while faces != 0u {
        let face = firstTrailingBit(faces);
        faces &= faces - 1u;
        if is_kink(slopes(beside(cell, face / 2u, face % 2u))) {
            return phi;
        }
    }
    return phi - STEP * (phi - phi / max(m, 1e-9));
}

@compute @workgroup_size(WG_SIZE)
fn relax_level(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let exists = lanes_inside(quad_cell(level, quad), vec3<i32>(level.cells));
    for (var n = 0u; n < 4u; n++) {
        let cell = 4u * quad + n;
        if exists[n] && is_open(cell) {
            new_level[cell] = relaxed(cell);
        }
    }
}
