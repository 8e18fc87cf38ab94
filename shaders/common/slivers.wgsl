// Small-aperture faces (slivers): open faces with an aperture below SLIVER. The importing kernel declares level,
// valid and open (face apertures).
#import layout
#import valid

// Small-aperture faces among the 12 minus faces of a quad, bit 4 axis + lane.
fn slivers_of(quad: u32) -> u32 {
    let word = valid[quad];
    if (word & SLIVERS) == 0u {
        return 0u;
    }
    var slivers = word >> OPEN & VALID;
    for (var bit = 0u; bit < 12u; bit++) {
        if open[sliver_face(quad, bit)] >= SLIVER {
            slivers &= ~(1u << bit);
        }
    }
    return slivers;
}

// Weight of blended velocities in the advection of small-aperture faces with these apertures.
fn blended_part(fractions: vec4<f32>) -> vec4<f32> {
    return max(2.0 / SLIVER * fractions - 1.0, vec4<f32>());
}

// Index of the face of a bit.
fn sliver_face(quad: u32, bit: u32) -> u32 {
    return 4u * (bit / 4u * level.quads + quad) + bit % 4u;
}
