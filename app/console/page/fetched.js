// Works as fetch(), but if no answer arrives, the error has a text of this page instead of the browser's.
export async function fetched(path, options = {}, unanswered = 'there is no connection to the console') {
  try {
    return await fetch(path, options);
  } catch (error) {
    if (options.signal?.aborted) throw error;
    throw new Error(unanswered);
  }
}
