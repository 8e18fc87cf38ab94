#import node_flags
#import real

// How a node may move in a sub-step: the first three numbers are a unit vector along which an obstacle holds it, or 0; the fourth are
// the components that neither a script nor a wall holds, as flags. The vector has none of the others.

fn free_components(freedom: vec4<f32>) -> vec3<bool> {
    return is_free(u32(freedom.w));
}

// The projector on the free directions. The length of the vector is 1 in f32 only.
fn free_part(freedom: vec4<f32>, y: Real3) -> Real3 {
    let kept = select(Real3(), y, free_components(freedom));
    let n = Real3(freedom.xyz);
    return kept - n * (dot(n, kept) / max(dot(n, n), Real(0.5)));
}

// Free directions: 0 to 3.
fn n_free(freedom: vec4<f32>) -> u32 {
    return countOneBits(u32(freedom.w)) - u32(any(freedom.xyz != vec3<f32>()));
}
