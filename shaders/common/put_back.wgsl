#import contact

// A feasible velocity near v, m/s: the node penetrates no surface in a sub-step of dt (s). Sweeps over the surfaces,
// as each limit may violate an earlier one. gaps: see contact; the importing kernel declares them.
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
