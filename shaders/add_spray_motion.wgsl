// diagnose with a level, after measure_motion: adds the momentum and the kinetic energy of the markers that fly. One thread.
// step. spray_sums: see spray_sums. partials: momentum (kg m/s), kinetic energy (J); the first in place.
#import spray_value
#import step
#import real

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> spray_sums: array<u32>;
@group(0) @binding(2) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(1)
fn add_spray_motion() {
    let dx = Real(step.dx);
    let mass = Real(MARKER_VOLUME) * Real(step.density) * dx * dx * dx;
    let speed = dx / Real(step.dt);
    let momentum = mass * speed;
    partials[0] += Real4(momentum * spray_value(1u), momentum * spray_value(2u), momentum * spray_value(3u), Real(0.5) * momentum * speed * spray_value(4u));
}
