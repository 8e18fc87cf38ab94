// The sides of the domain, for markers.
#import step

// Smallest distance of markers from walls, cells, so that rounding cannot move them out of the domain.
const WALL_GAP = 0.01;

fn inside_walls(x: vec3<f32>, step: Step) -> vec3<f32> {
    let gap = vec3<f32>(WALL_GAP * step.dx);
    return clamp(x, gap, step.size - gap);
}

// Whether a point is beyond an open side: bits 0 to 5 of step.open_sides are -x, +x, -y, +y, -z, +z.
fn beyond_open_side(x: vec3<f32>, step: Step) -> bool {
    if step.open_sides == 0u {
        return false;
    }
    let low = (vec3<u32>(step.open_sides) >> vec3<u32>(0u, 2u, 4u) & vec3<u32>(1u)) != vec3<u32>();
    let high = (vec3<u32>(step.open_sides) >> vec3<u32>(1u, 3u, 5u) & vec3<u32>(1u)) != vec3<u32>();
    return any((low & (x < vec3<f32>())) | (high & (x > step.size)));
}
