#import contact

// A velocity v, m/s, that takes a node beyond nothing in a sub-step of dt (s), near another: before one surface after the other, again
// and again, as the next may put it beyond the last. gaps: see contact; the including file declares them.
fn put_back(node: u32, n_nodes: u32, v: Real3, dt: Real) -> Real3 {
    let walls = gaps[node];
    var back = before_walls(walls, v, dt);
    if arrayLength(&gaps) > n_nodes {
        let surface = gaps[n_nodes + node];
        for (var sweep = 1; sweep < SWEEPS; sweep++) {
            back = before_walls(walls, before_obstacle(walls, surface, back, dt), dt);
        }
        back = before_obstacle(walls, surface, back, dt);
    }
    return back;
}
