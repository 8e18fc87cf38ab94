#import real

// Sums over the elements of a node, in ascending order.
// incidence: index of the first corner of each node, and the total; then the corners, 4 element + corner. products:
// per element, a vector at corners 1, 2, 3 in three sections; corner 0 is minus their sum. The importing kernel
// declares them.
fn gather(node: u32, n_elements: u32) -> Real3 {
    var sum = Real3();
    let last = incidence[node + 1u];
    for (var at = incidence[node]; at < last; at++) {
        let element = incidence[at] / 4u;
        let corner = incidence[at] % 4u;
        if corner == 0u {
            sum -= products[element].xyz + products[n_elements + element].xyz + products[2u * n_elements + element].xyz;
        } else {
            sum += products[(corner - 1u) * n_elements + element].xyz;
        }
    }
    return sum;
}
