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

// Index of the face of a bit.
fn sliver_face(quad: u32, bit: u32) -> u32 {
    return 4u * (bit / 4u * level.quads + quad) + bit % 4u;
}
