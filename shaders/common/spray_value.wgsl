// A sum over the markers that fly, see spray_sums. The importing kernel declares spray_sums.
#import spray_sums
#import real

fn spray_value(sum: u32) -> Real {
    let high = Real(bitcast<i32>(spray_sums[2u * sum + 1u]));
    return (high * Real(4294967296.0) + Real(spray_sums[2u * sum])) / Real(QUANTA);
}
