// Vehicles and stations in words: a vehicle by its system id and what people call it, a station by its own id.

// The nodes of stations are negative, so that they are no vehicle's system id.
export const idAndName = ({ sysid, name }) => (name ? `${sysid} ${name}` : String(sysid));
export const vehicleName = (snapshot) => `Vehicle ${idAndName(snapshot)}`;

export const nodeName = (node) => (node < 0 ? `station ${-1 - node}` : String(node));
