//! Counting sort.

/// Order of items by their keys below `n_keys`, equal keys in the order of the items: the start of each key's items, one more
/// than there are keys, and the numbers of the items.
pub(crate) fn counting_sort(n_keys: usize, keys: impl Iterator<Item = usize> + Clone) -> (Vec<usize>, Vec<usize>) {
    let mut start = vec![0; n_keys + 1];
    for key in keys.clone() {
        start[key + 1] += 1;
    }
    for key in 0..n_keys {
        start[key + 1] += start[key];
    }
    let mut next = start.clone();
    let mut order = vec![0; start[n_keys]];
    for (item, key) in keys.enumerate() {
        order[next[key]] = item;
        next[key] += 1;
    }
    (start, order)
}
