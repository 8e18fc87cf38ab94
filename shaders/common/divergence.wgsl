// The importing kernel declares step, flags (see active) and maxima: bits of the largest speed, then of the largest
// divergence, 1/s.
#import lanes
#import obstacles
#import step
#import real

// Records the remaining divergence of active lanes after obstacles' flux, times dx, m/s.
fn note_divergence(quad: u32, left: Real4) {
    let size = abs(vec4<f32>(left - taken_by_obstacles(quad))) * step.inv_dx;
    let bits = bitcast<vec4<u32>>(select(vec4<f32>(), size, bit_lanes(flags[quad])));
    let largest = max(max(bits.x, bits.y), max(bits.z, bits.w));
    if largest > atomicLoad(&maxima[1]) {
        atomicMax(&maxima[1], largest);
    }
}
