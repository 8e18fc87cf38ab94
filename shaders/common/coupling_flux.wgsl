#import coupling
#import real

// (J x) over the lanes of a wet quad. The including file declares coupling, words (see coupling), pairs (bits of J, then 4 node + lane),
// flags (active lanes) and x (Real4 per node).
fn flux(wet: u32) -> Real4 {
    var sum = Real4();
    let last = words[coupling.quad_starts + wet + 1u];
    for (var at = words[coupling.quad_starts + wet]; at < last; at++) {
        let pair = quad_pairs[at];
        sum[pair.w % 4u] += dot(Real3(bitcast<vec3<f32>>(pair.xyz)), x[pair.w / 4u].xyz);
    }
    let lanes = (vec4<u32>(flags[words[wet]]) & vec4<u32>(1u, 2u, 4u, 8u)) != vec4<u32>();
    return select(Real4(), sum, lanes);
}
