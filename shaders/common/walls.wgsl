// The walls of the domain, for markers.
#import step

// Distance that markers keep from walls, cells: keeps the cell of a marker inside the domain whatever the rounding.
const WALL_GAP = 0.01;

fn inside_walls(x: vec3<f32>, step: Step) -> vec3<f32> {
    let gap = vec3<f32>(WALL_GAP * step.dx);
    return clamp(x, gap, step.size - gap);
}
