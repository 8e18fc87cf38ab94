// Marks of thick liquid along y or z. The importing kernel declares band_flags: array<u32> and thick_in: array<u32>,
// per quad lanes of thick liquid.

// Distance up to which thick liquid counts, cells; along x in mark_thick.wgsl.
const THIN_REACH = 3;

// Marks within that distance of a quad that is number `at` of n along an axis with a stride in quads.
fn thick_along(quad: u32, at: i32, n: i32, stride: u32) -> u32 {
    var bits = 0u;
    let end = min(at + THIN_REACH, n - 1);
    for (var other = max(at - THIN_REACH, 0); other <= end; other++) {
        let there = u32(i32(quad) + (other - at) * i32(stride));
        if band_flags[there] != 0u {
            bits |= thick_in[there];
        }
    }
    return bits;
}
