// As fetch; that no answer came is said in words that the page has, and not as each browser says it.
export async function fetched(path, options = {}, unanswered = 'there is no connection to the console') {
  try {
    return await fetch(path, options);
  } catch (error) {
    if (options.signal?.aborted) throw error;
    throw new Error(unanswered);
  }
}
