// extrapolate, where bodies cut the grid, before the layers: what a valid sliver shows of its velocity to closed faces and air around it.
// A body that comes near another, or a wall, drives what is between them out through faces of almost no area, at any speed. As the
// velocity of the whole face next to it that would be momentum out of nothing. So
// velocity_next = u + (1 - a / SLIVER) (m - u), m = sum_n a_n u_n / sum_n a_n,
// a the open fraction, n the valid ones of the 26 neighbours of the same axis. One thread per quad of the band.
// level. args, list: the band. valid: see valid. open: fractions of the faces. velocity: faces, m/s.
// velocity_next: at slivers the bits of these, or NO_VELOCITY at those that are not valid.
#import dispatch
#import face_index
#import lanes
#import layout
#import valid

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> args: array<u32>;
@group(0) @binding(2) var<storage, read> list: array<u32>;
@group(0) @binding(3) var<storage, read> valid: array<u32>;
@group(0) @binding(4) var<storage, read> open: array<f32>;
@group(0) @binding(5) var<storage, read> velocity: array<f32>;
@group(0) @binding(6) var<storage, read_write> velocity_next: array<u32>;

// Of a sliver with a fraction open. Without valid neighbours it shows its own.
fn blended(axis: u32, cell: vec3<i32>, face: u32, fraction: f32) -> f32 {
    let extents = face_extents(level, axis);
    var sum = 0.0;
    var weight = 0.0;
    for (var number = 0; number < 27; number++) {
        let at = cell + vec3<i32>(number % 3, number / 3 % 3, number / 9) - 1;
        if number == 13 || any(at < vec3<i32>()) || any(at >= extents) {
            continue;
        }
        let neighbour = face_index(axis, at);
        let word = valid[neighbour / 4u - axis * level.quads];
        if (word >> (4u * axis + neighbour % 4u) & 1u) != 0u {
            sum += open[neighbour] * velocity[neighbour];
            weight += open[neighbour];
        }
    }
    let own = velocity[face];
    if weight == 0.0 {
        return own;
    }
    return own + (1.0 - fraction / SLIVER) * (sum / weight - own);
}

@compute @workgroup_size(WG_SIZE)
fn blend_slivers(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= args[3] {
        return;
    }
    let quad = list[index];
    let word = valid[quad];
    if (word & SLIVERS) == 0u {
        return;
    }
    let cell = quad_cell(level, quad);
    var faces = word >> OPEN & VALID;
    while faces != 0u {
        let bit = firstTrailingBit(faces);
        faces &= faces - 1u;
        let axis = bit / 4u;
        let face = 4u * (axis * level.quads + quad) + bit % 4u;
        let fraction = open[face];
        if fraction < SLIVER {
            velocity_next[face] = NO_VELOCITY;
            if (word >> bit & 1u) != 0u {
                let at = cell + vec3<i32>(i32(bit % 4u), 0, 0);
                velocity_next[face] = bitcast<u32>(blended(axis, at, face, fraction));
            }
        }
    }
}
