// probe, fluxes: volume of liquid per second through rectangles normal to an axis. Each face counts with its velocity,
// its overlap with the rectangle, its aperture, and its wet part: 1/2 - phi / dx with phi the mean of the two cells.
// Between two planes of faces the flux is linear.
// One workgroup per rectangle: strided sums over its faces, then a tree.
// level, step. rectangles: see probe_rectangle. liquid_distance: m. open: apertures. velocity: faces, m/s. values:
// m^3/s, the first of four words.
#import dispatch
#import layout
#import probe_rectangle
#import real
#import step
#import tree

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> rectangles: array<ProbeRectangle>;
@group(0) @binding(3) var<storage, read> liquid_distance: array<f32>;
@group(0) @binding(4) var<storage, read> open: array<f32>;
@group(0) @binding(5) var<storage, read> velocity: array<f32>;
@group(0) @binding(6) var<storage, read_write> values: array<f32>;

// Liquid distance at a face, m: the mean of the cells beside it, at a wall that of the one inside.
fn face_distance(axis: u32, face: vec3<u32>) -> f32 {
    var before = face;
    var after = face;
    before[axis] = max(face[axis], 1u) - 1u;
    after[axis] = min(face[axis], level.cells[axis] - 1u);
    return 0.5 * (liquid_distance[cell_index(level, before)] + liquid_distance[cell_index(level, after)]);
}

@compute @workgroup_size(FOLD_SIZE)
fn probe_fluxes(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let rectangle = rectangles[group_index(workgroup)];
    let axis = rectangle.axis;
    let b = (axis + 1u) % 3u;
    let c = (axis + 2u) % 3u;
    let low = rectangle.low * step.inv_dx;
    let high = rectangle.high * step.inv_dx;
    let first = cell_of(level, low);
    let last = cell_of(level, high);
    let below = first[axis];
    let part = low[axis] - f32(below);
    let wide = last[b] - first[b] + 1u;
    let n = wide * (last[c] - first[c] + 1u);
    var sum = Real();
    for (var ix = lane; ix < 2u * n; ix += FOLD_SIZE) {
        let upper = ix >= n;
        let at = select(ix, ix - n, upper);
        var face = vec3<u32>();
        face[axis] = below + u32(upper);
        face[b] = first[b] + at % wide;
        face[c] = first[c] + at / wide;
        let corner = vec3<f32>(face);
        let sides = max(min(high, corner + 1.0) - max(low, corner), vec3<f32>());
        let share = sides[b] * sides[c] * select(1.0 - part, part, upper);
        let wet = clamp(0.5 - face_distance(axis, face) * step.inv_dx, 0.0, 1.0);
        let index = 4u * axis * level.quads + cell_index(level, face);
        sum += Real(velocity[index]) * Real(open[index] * wet * share);
    }
    let total = tree(Real4(sum, Real(), Real(), Real()), lane);
    if lane == 0u {
        values[4u * rectangle.place] = f32(total.x) * step.dx * step.dx;
    }
}
