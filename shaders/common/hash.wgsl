// A round of lowbias32 (Wellons 2018). The hash of a list of numbers takes one round per number: hash = scatter(hash ^ number).
fn scatter(bits: u32) -> u32 {
    var x = (bits ^ (bits >> 16u)) * 0x7feb352du;
    x = (x ^ (x >> 15u)) * 0x846ca68bu;
    return x ^ (x >> 16u);
}
