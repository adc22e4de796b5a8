// The ends of ranges in words: a vehicle by its system id, a station by its own id.

// The nodes of stations are negative, so that they are no vehicle's system id.
export const nodeName = (node) => (node < 0 ? `station ${-1 - node}` : String(node));
