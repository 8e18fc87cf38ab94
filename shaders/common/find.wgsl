#import components

// The root of a cell's component. The including file declares labels as atomics.
fn find(cell: u32) -> u32 {
    var at = cell;
    var above = atomicLoad(&labels[at]) & ~MARKS;
    while above != at {
        at = above;
        above = atomicLoad(&labels[at]) & ~MARKS;
    }
    return at;
}
