// Elements of the page: find one by its id, make one with a text and attributes.
// The words of the service by what they are of; the welcome brings them.
export const words = {};
export const $ = (id) => document.getElementById(id);

export function write(id, text) {
  if ($(id).textContent !== text) $(id).textContent = text;
}

export function chip(element, level, text) {
  element.dataset.level = level;
  element.textContent = text;
}

export function part(tag, text, attributes = {}) {
  const element = document.createElement(tag);
  element.textContent = text;
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}
