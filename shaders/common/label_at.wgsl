// The label with the largest tent weight around a point, the first of equal ones; 0 where no cell around has a label.
// Cells beyond a wall are those at the wall.
// The importing kernel declares level: Layout and labels: array<u32>, 0 for none.
#import layout

// at: position in cells, x / dx.
fn label_at(at: vec3<f32>) -> u32 {
    let low = floor(at - 0.5);
    let upper = at - 0.5 - low;
    let top = vec3<i32>(level.cells) - 1;
    var most = 0.0;
    var label = 0u;
    for (var corner = 0; corner < 8; corner++) {
        let up = vec3<i32>(corner) >> vec3<u32>(0u, 1u, 2u) & vec3<i32>(1);
        let cell = vec3<u32>(clamp(vec3<i32>(low) + up, vec3<i32>(), top));
        let here = labels[cell_index(level, cell)];
        let weights = select(1.0 - upper, upper, up == vec3<i32>(1));
        let weight = weights.x * weights.y * weights.z;
        if here > 0u && (label == 0u || weight > most) {
            label = here;
            most = weight;
        }
    }
    return label;
}
