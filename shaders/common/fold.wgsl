#import real
#import tree

// Sum of partials[first .. first + n] by one workgroup of FOLD_SIZE threads: strided sums, then a tree; the order depends on n
// alone. The including file declares partials. All threads must call it, and a barrier must stand between two calls.
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
