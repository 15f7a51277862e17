// Sets of cells, a bit each, with the number of members before every word; no kernel by itself.
// Needs `members` and `before`.

// Member number `rank`, in their order.
fn member(rank: u32) -> u32 {
    var low = 0u;
    var high = p.words;
    while (high - low > 1u) {
        let middle = (low + high) / 2u;
        // The last word with no more than `rank` members before it.
        if (before[middle] <= rank) {
            low = middle;
        } else {
            high = middle;
        }
    }
    var word = members[low];
    for (var skip = rank - before[low]; skip > 0u; skip--) {
        // Clears the lowest member.
        word &= word - 1u;
    }
    return 32u * low + firstTrailingBit(word);
}
