// What the host asks kernels in the search for contacts: the word that it tells them, after the words that they answer with.
const BEYOND = 0u;
const PULLED = 1u;
const TOLD = 2u;
