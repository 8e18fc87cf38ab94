#import real

// What obstacles take up of the cells of a quad, m/s: nothing where they stand still.
fn taken_by_obstacles(quad: u32) -> Real4 {
    return Real4();
}
