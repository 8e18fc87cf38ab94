#import real
#import tree

// Sum of partials[first .. first + n] by one workgroup of FOLD_SIZE threads: strided sums, then a tree, in an order
// that depends on n alone. The importing kernel declares partials. All threads must call it, with a barrier between
// two calls.
fn fold_from(first: u32, n: u32, lane: u32) -> Real4 {
    var sum = Real4();
    for (var ix = lane; ix < n; ix += FOLD_SIZE) {
        sum += partials[first + ix];
    }
    return tree(sum, lane);
}

// Sum of partials[0 .. n].
fn fold(n: u32, lane: u32) -> Real4 {
    return fold_from(0u, n, lane);
}
