// Depth of the band of markers, and the level at a marker. The importing kernel declares liquid_distance: array<f32>, m, and step.
#import corner
#import step

// cells
const MARKER_DEPTH = 3.0;

// The level after all changes, cells.
fn level_at(place: Corner) -> f32 {
    let points = corner_points(place);
    let at = points[0];
    let next = points[1];
    let minus = vec4<f32>(liquid_distance[at.x], liquid_distance[at.y], liquid_distance[at.z], liquid_distance[at.w]);
    let plus = vec4<f32>(liquid_distance[next.x], liquid_distance[next.y], liquid_distance[next.z], liquid_distance[next.w]);
    return step.inv_dx * mix_points(minus, plus, place.f);
}
