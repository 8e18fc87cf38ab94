#import coupling
#import real

// (J^T p) of a node. The including file declares coupling, words (see coupling), pairs (bits of J, then the padded index of the cell),
// flags (active lanes) and p (per quad).
fn force(node: u32) -> Real3 {
    var sum = Real3();
    let last = words[coupling.node_starts + node + 1u];
    for (var at = words[coupling.node_starts + node]; at < last; at++) {
        let pair = node_pairs[at];
        let quad = pair.w / 4u;
        let lane = pair.w % 4u;
        if (flags[quad] >> lane & 1u) == 1u {
            sum += Real3(bitcast<vec3<f32>>(pair.xyz)) * Real(p[quad][lane]);
        }
    }
    return sum;
}
