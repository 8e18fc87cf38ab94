// extrapolate with a level, after the first layer: faces beside the liquid continue its slope. Each valid neighbour u1
// beside a face adds minmod(u1 - u2, u2 - u3) of the valid faces u1, u2, u3 in a row behind it to the mean, each
// difference at most dx / (2 dt) (reason in the twin, reference/extrapolate.rs).
// Valid faces are never written and others never read but their own, so the order of the threads does not matter. One
// thread per quad of the band.
// level, step. band_args, band_list: the band. valid_in: before the layer, see valid. velocity: faces, m/s, in place.
#import dispatch
#import face_index
#import face_marks
#import layout
#import lanes
#import step
#import valid

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> valid_in: array<u32>;
@group(0) @binding(5) var<storage, read_write> velocity: array<f32>;

fn is_valid(axis: u32, at: vec3<i32>) -> bool {
    if any(at < vec3<i32>()) || any(at >= face_extents(level, axis)) {
        return false;
    }
    let quad = face_index(axis, at) / 4u - axis * level.quads;
    return (valid_in[quad] >> (4u * axis + u32(at.x) % 4u) & 1u) != 0u;
}

// The slope of three faces in a row from a valid one on, m/s; 0 unless all are valid.
fn slope(axis: u32, first: vec3<i32>, way: vec3<i32>) -> f32 {
    if !is_valid(axis, first + way) || !is_valid(axis, first + 2 * way) {
        return 0.0;
    }
    let middle = velocity[face_index(axis, first + way)];
    let near = velocity[face_index(axis, first)] - middle;
    let far = middle - velocity[face_index(axis, first + 2 * way)];
    if sign(near) != sign(far) {
        return 0.0;
    }
    return sign(near) * min(min(abs(near), abs(far)), 0.5 * step.dx / step.dt);
}

@compute @workgroup_size(WG_SIZE)
fn extrapolate_slope(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let here = valid_in[quad] & VALID;
    if here == VALID {
        return;
    }
    let cell = quad_cell(level, quad);
    let sides = sides_of(quad, cell, here);
    var beside = faces_inside(cell) & ~here & any_of(sides.row | sides.beside);
    while beside != 0u {
        let bit = firstTrailingBit(beside);
        beside &= beside - 1u;
        let axis = bit / 4u;
        let at = cell + vec3<i32>(i32(bit % 4u), 0, 0);
        var sum = 0.0;
        var count = 0.0;
        for (var side = 0u; side < 6u; side++) {
            let way = along(side / 2u) * (2 * i32(side % 2u) - 1);
            if is_valid(axis, at + way) {
                sum += slope(axis, at + way, way);
                count += 1.0;
            }
        }
        velocity[face_index(axis, at)] += sum / max(count, 1.0);
    }
}
