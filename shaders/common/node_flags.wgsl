// Which components of a node's velocity are free: bits 0, 1, 2 of its flags for x, y, z. The others are prescribed.
fn is_free(flags: u32) -> vec3<bool> {
    return (vec3<u32>(flags) & vec3<u32>(1u, 2u, 4u)) != vec3<u32>();
}
