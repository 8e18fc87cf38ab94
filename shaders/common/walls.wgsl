// The sides of the domain, for markers.
#import step

// Smallest distance of markers from walls, cells, so that rounding cannot move them out of the domain.
const WALL_GAP = 0.01;

fn inside_walls(x: vec3<f32>, step: Step) -> vec3<f32> {
    let gap = vec3<f32>(WALL_GAP * step.dx);
    return clamp(x, gap, step.size - gap);
}

// The axes whose minus (0) or plus (1) side is open: bits 0 to 5 of step.open_sides are -x, +x, -y, +y, -z, +z.
fn open_sides(step: Step, side: u32) -> vec3<bool> {
    return (vec3<u32>(step.open_sides) >> (vec3<u32>(0u, 2u, 4u) + side) & vec3<u32>(1u)) != vec3<u32>();
}

// Whether a point is beyond an open side.
fn beyond_open_side(x: vec3<f32>, step: Step) -> bool {
    if step.open_sides == 0u {
        return false;
    }
    return any((open_sides(step, 0u) & (x < vec3<f32>())) | (open_sides(step, 1u) & (x > step.size)));
}
