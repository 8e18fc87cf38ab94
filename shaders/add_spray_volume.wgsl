// diagnose with a level, after measure_volume: adds the volume of the markers that fly, and their potential energy - m g . x. One thread.
// step. spray_sums: see spray_sums. partials: volume (m^3), potential energy (J), 0, 0; the first in place.
#import spray_value
#import step
#import real

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> spray_sums: array<u32>;
@group(0) @binding(2) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(1)
fn add_spray_volume() {
    let dx = Real(step.dx);
    let volume = Real(MARKER_VOLUME) * dx * dx * dx;
    let weight = volume * Real(step.density) * Real(length(step.gravity));
    partials[0] += Real4(volume * spray_value(0u), -weight * dx * spray_value(5u), Real(), Real());
}
