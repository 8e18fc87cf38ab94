// Joins the trees of two cells (union-find with atomicMin, Komura 2015, Playne and Hawick 2018). The importing kernel
// declares labels as atomics.
#import find

fn join(a: u32, b: u32) {
    var low = a;
    var high = b;
    loop {
        let roots = vec2<u32>(find(low), find(high));
        low = min(roots.x, roots.y);
        high = max(roots.x, roots.y);
        if low == high {
            return;
        }
        let before = atomicMin(&labels[high], low);
        if before == high {
            return;
        }
        // Another thread was quicker and hung the root below another cell, which now has to be joined instead.
        high = before;
    }
}
