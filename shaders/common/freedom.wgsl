#import node_flags
#import real

// Constraint projector of a node in a sub-step. The first three numbers are a unit vector along which an obstacle
// constrains it, or 0; the fourth contains flags of the components that are neither prescribed nor constrained by a
// wall. The vector has no other components.

fn free_components(freedom: vec4<f32>) -> vec3<bool> {
    return is_free(u32(freedom.w));
}

// Projects y to the free directions. The vector is normalised to f32 only.
fn free_part(freedom: vec4<f32>, y: Real3) -> Real3 {
    let kept = select(Real3(), y, free_components(freedom));
    let n = Real3(freedom.xyz);
    return kept - n * (dot(n, kept) / max(dot(n, n), Real(0.5)));
}

// Number of free directions: 0 to 3.
fn n_free(freedom: vec4<f32>) -> u32 {
    return countOneBits(u32(freedom.w)) - u32(any(freedom.xyz != vec3<f32>()));
}
