// The importing kernel declares level: Layout and liquid_distance: array<f32>, cell centres, m.
#import layout

// Whether none of the eight cells around a position (cells) contains liquid. Cells beyond a wall are those at the wall.
fn flies(at: vec3<f32>) -> bool {
    let low = vec3<i32>(floor(at - 0.5));
    let top = vec3<i32>(level.cells) - 1;
    var least = 1.0;
    for (var corner = 0; corner < 8; corner++) {
        let up = vec3<i32>(corner) >> vec3<u32>(0u, 1u, 2u) & vec3<i32>(1);
        let cell = vec3<u32>(clamp(low + up, vec3<i32>(), top));
        least = min(least, liquid_distance[cell_index(level, cell)]);
    }
    return least >= 0.0;
}
