export async function open() { throw { title: "To come", detail: "" }; }
