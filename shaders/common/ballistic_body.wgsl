#import dispatch
#import tree

// Whether a node of a body touches something, one workgroup per body without constraints and loads.
// The importing kernel declares free_bodies (ranges of nodes), ballistic (per node) and touches(node).
var<workgroup> sh_touched: atomic<u32>;

// The body's nodes; none beyond the last body.
fn nodes_of(body: u32) -> vec2<u32> {
    if body < arrayLength(&free_bodies) {
        return free_bodies[body].xy;
    }
    return vec2<u32>();
}

fn body_touches(nodes: vec2<u32>, lane: u32) -> bool {
    for (var node = nodes.x + lane; node < nodes.y; node += FOLD_SIZE) {
        if touches(node) {
            atomicStore(&sh_touched, 1u);
        }
    }
    workgroupBarrier();
    return atomicLoad(&sh_touched) != 0u;
}

fn mark(nodes: vec2<u32>, lane: u32, value: u32) {
    for (var node = nodes.x + lane; node < nodes.y; node += FOLD_SIZE) {
        ballistic[node] = value;
    }
}
