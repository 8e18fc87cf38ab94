#import freedom
#import real
#import symmetric

// The block of a node on the diagonal of S: mass I + sum zeta_K K_aa over the elements of the node, kg/s. The importing kernel declares
// incidence (see gather) and rotated (see solid_blocks).
fn node_block(node: u32, n_elements: u32, mass: Real) -> Symmetric {
    var block = Symmetric(Real3(mass), Real3());
    let last = incidence[node + 1u];
    for (var at = incidence[node]; at < last; at++) {
        let element = incidence[at] / 4u;
        let corner = incidence[at] % 4u;
        let first = rotated[element];
        let second = rotated[n_elements + element];
        var g = -(first.xyz + second.xyz + rotated[2u * n_elements + element].xyz);
        if corner > 0u {
            g = rotated[(corner - 1u) * n_elements + element].xyz;
        }
        let both = first.w + second.w;
        block.squares += both * (g * g) + Real3(second.w * dot(g, g));
        block.products += both * (g.xxy * g.yzz);
    }
    return block;
}

fn mean_of(block: Symmetric) -> Real {
    return (block.squares.x + block.squares.y + block.squares.z) / Real(3.0);
}

// The unit vector along which an obstacle holds a node, or 0.
fn held_along(freedom: vec4<f32>) -> Real3 {
    let along = Real3(freedom.xyz);
    return along / sqrt(max(dot(along, along), Real(0.5)));
}

// The block without what is held: along n, a unit vector or 0, it becomes the mean and couples with nothing, and other held components
// couple with nothing.
fn kept_block(freedom: vec4<f32>, n: Real3, block: Symmetric) -> Symmetric {
    let free = free_components(freedom);
    var kept = Symmetric(block.squares, select(Real3(), block.products, free.xxy & free.yzz));
    let bn = times(kept, n);
    let both = dot(n, bn) + mean_of(block);
    kept.squares += n * (both * n - Real(2.0) * bn);
    kept.products += both * (n.xxy * n.yzz) - (bn.xxy * n.yzz + n.xxy * bn.yzz);
    return kept;
}
