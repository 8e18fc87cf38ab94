// Liquid volume of cells. The importing kernel declares step: Step and solid_distance: array<vec4<f32>>, m, cell
// centres; one quad far outside in a scene without obstacles.
#import step
#import real

// Open volume of the cells of a quad, fraction of dx^3.
fn open_volume(quad: u32) -> Real4 {
    let distance = solid_distance[min(quad, arrayLength(&solid_distance) - 1u)];
    return clamp(Real4(Real(0.5)) + Real4(distance) / Real(step.dx), Real4(), Real4(Real(1.0)));
}

// Liquid volume, fraction of dx^3, from the liquid distance, m.
fn liquid_volume(quad: u32, phi: vec4<f32>) -> Real4 {
    return open_volume(quad) * clamp(Real4(Real(0.5)) - Real4(phi) / Real(step.dx), Real4(), Real4(Real(1.0)));
}
